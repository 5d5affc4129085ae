//! What several occluders leave of the light (eisemann2006, §3.3).

use crate::config::Combination;

impl Combination {
    /// Visible share (0..=1) of the light behind slices that block the shares `shadows` (0..=1) of it each. By product it is
    /// what independent occluders leave (eq. 5), by sum what disjoint ones do, by maximum what nested ones do.
    pub fn visibility(self, shadows: impl Iterator<Item = f32>) -> f32 {
        match self {
            Self::Product => shadows.fold(1.0, |v, i| v * (1.0 - i)),
            Self::Sum => (1.0 - shadows.sum::<f32>()).max(0.0),
            Self::Maximum => 1.0 - shadows.fold(0.0, f32::max),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_product_lies_between_sum_and_maximum(shadows in proptest::collection::vec(0.0..=1.0f32, 0..16)) {
            let [product, sum, maximum] =
                [Combination::Product, Combination::Sum, Combination::Maximum].map(|c| c.visibility(shadows.iter().copied()));
            prop_assert!(sum <= product + 1e-6 && product <= maximum + 1e-6, "{} {} {}", sum, product, maximum);
        }

        #[test]
        fn one_occluder_is_itself_and_a_full_one_is_dark(shadow in 0.0..=1.0f32, others in proptest::collection::vec(0.0..=1.0f32, 0..8)) {
            for rule in Combination::ALL {
                let alone = [0.0, shadow, 0.0];
                prop_assert!((rule.visibility(alone.into_iter()) - (1.0 - shadow)).abs() < 1e-6);
                let all = others.iter().copied().chain([1.0]);
                prop_assert!(rule.visibility(all) < 1e-6);
            }
        }
    }
}
