//! The nearest rising sequence.

/// Smallest step of ln exposure from one level to the next: keeps the inverse defined.
pub(super) const LEAST_STEP: f64 = 1e-4;

/// Projects values on the sequences that rise by at least [`LEAST_STEP`], in weighted least squares: the pool-adjacent-
/// violators algorithm (Barlow et al. 1972) on the values less that ramp.
pub(super) fn project(values: &mut [f64], weights: &[f64]) {
    // Blocks of (weighted mean, weight, count).
    let mut blocks: Vec<(f64, f64, usize)> = Vec::new();
    for (k, (value, weight)) in values.iter().zip(weights).enumerate() {
        let mut block = (value - LEAST_STEP * k as f64, weight.max(1e-12), 1);
        while let Some(last) = blocks.pop_if(|last| last.0 > block.0) {
            let weight = last.1 + block.1;
            block = ((last.0 * last.1 + block.0 * block.1) / weight, weight, last.2 + block.2);
        }
        blocks.push(block);
    }
    let flat = blocks.iter().flat_map(|&(mean, _, count)| std::iter::repeat_n(mean, count));
    for (k, (value, mean)) in values.iter_mut().zip(flat).enumerate() {
        *value = mean + LEAST_STEP * k as f64;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_dent_is_filled_to_its_weighted_mean() {
        let mut values = [0.0, 3.0, 1.0, 4.0];
        project(&mut values, &[1.0, 1.0, 3.0, 1.0]);
        assert!((values[1] - 1.5).abs() < 1e-3 && (values[2] - 1.5).abs() < 1e-3, "{values:?}");
        assert_eq!((values[0], values[3]), (0.0, 4.0));
    }

    proptest! {
        #[test]
        fn the_result_rises_and_rising_input_stays(mut values in prop::collection::vec(-5.0..5.0f64, 2..40)) {
            let weights = vec![1.0; values.len()];
            project(&mut values, &weights);
            prop_assert!(values.windows(2).all(|w| w[1] - w[0] > 0.5 * LEAST_STEP));
            let before = values.clone();
            project(&mut values, &weights);
            prop_assert!(values.iter().zip(&before).all(|(a, b)| (a - b).abs() < 1e-9));
        }
    }
}
