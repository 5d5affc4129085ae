//! Intensity transfers: what each source takes from a stored code (Gibson et al. 2003, §7.1).
//!
//! A camera's response T is not linear, so what a source takes from a code depends on which other sources are hidden
//! too, and that is not known when the transfers are made. The paper deals the sources at random into two sets and
//! takes the transfers of each as if it were hidden whole and the other not at all: exact where that is so, an
//! approximation elsewhere.

use rand::Rng;
use rand::seq::SliceRandom;

/// The largest code value of 8 bits.
pub const TOP: f32 = 255.0;

/// One of the two sets that sources are dealt into.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Set {
    /// The one that gets the stated share.
    First,
    /// All others.
    Second,
}

/// Deals `count` sources at random into two sets; `first_share` (0..=1) of them, rounded, come into the first. A half is
/// the paper's choice; at 1 all sources are taken to be hidden together.
pub fn deal(count: usize, first_share: f64, rng: &mut impl Rng) -> Vec<Set> {
    let first = (first_share.clamp(0.0, 1.0) * count as f64).round() as usize;
    let mut sets: Vec<Set> = (0..count).map(|id| if id < first { Set::First } else { Set::Second }).collect();
    sets.shuffle(rng);
    sets
}

/// The intensity transfers S_ij of a receiver vertex i (Figure 4), in the order of its sources, which should be that of
/// decreasing average transfer.
///
/// `radiance` is what the plate shows there, L_i; `transfers` are each source's set and part L_ij of it, ≥ 0, plate
/// units; `tone` is T, from radiance to code values, rising. The result has the unit of T and is never negative. The
/// transfers of one set add up to T(L_i) − T(L_i − Σ L_ij) exactly if T gives whole numbers, else to rounding.
pub fn intensity_transfers(
    radiance: [f32; 3],
    transfers: impl IntoIterator<Item = (Set, [f32; 3])>,
    tone: impl Fn([f32; 3]) -> [f32; 3],
) -> impl Iterator<Item = [f32; 3]> {
    let mut left = [radiance.map(f64::from); 2];
    let mut code = [tone(radiance); 2];
    transfers.into_iter().map(move |(set, transfer)| {
        let (left, code) = (&mut left[set as usize], &mut code[set as usize]);
        (0..3).for_each(|c| left[c] = (left[c] - f64::from(transfer[c])).max(0.0));
        let after = tone(left.map(|v| v as f32));
        let taken = std::array::from_fn(|c| code[c] - after[c]);
        *code = after;
        taken
    })
}

/// L_i: the mean radiance of the plate around each of `count` receiver vertices. `pixels` are the receiver vertices that
/// a pixel lies between, its weights of them, and what it shows; a vertex that no pixel touches has 0.
pub fn vertex_radiance(
    count: usize,
    pixels: impl IntoIterator<Item = ([u32; 3], [f32; 3], [f32; 3])>,
) -> Vec<[f32; 3]> {
    let mut sums = vec![([0.0f64; 3], 0.0f64); count];
    for (vertices, weights, radiance) in pixels {
        for (vertex, weight) in vertices.into_iter().zip(weights.map(|w| f64::from(w.max(0.0)))) {
            let (sum, all) = &mut sums[vertex as usize];
            (0..3).for_each(|c| sum[c] += weight * f64::from(radiance[c].max(0.0)));
            *all += weight;
        }
    }
    sums.into_iter().map(|(sum, all)| sum.map(|v| if all > 0.0 { (v / all) as f32 } else { 0.0 })).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::response::Response;
    use proptest::prelude::*;
    use rand::{SeedableRng, rngs::SmallRng};

    fn srgb(v: [f32; 3]) -> [f32; 3] {
        v.map(|v| {
            let v = v.clamp(0.0, 1.0);
            TOP * if v <= 0.003_130_8 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 }
        })
    }

    fn rounded(v: [f32; 3]) -> [f32; 3] {
        let response = Response::srgb();
        response.code_of(v).map(|c| (c * TOP).round())
    }

    /// A radiance, and parts of it that together stay below it.
    fn vertex() -> impl Strategy<Value = ([f32; 3], Vec<[f32; 3]>)> {
        let parts = prop::collection::vec(prop::array::uniform3(0.0f32..1.0), 1..60);
        (prop::array::uniform3(0.01f32..1.2), parts, 0.1f32..1.0).prop_map(|(radiance, mut parts, share)| {
            for c in 0..3 {
                let sum: f32 = parts.iter().map(|p| p[c]).sum();
                parts.iter_mut().for_each(|p| p[c] *= share * radiance[c] / sum.max(1e-6));
            }
            (radiance, parts)
        })
    }

    fn transfers(
        radiance: [f32; 3],
        parts: &[[f32; 3]],
        sets: &[Set],
        tone: impl Fn([f32; 3]) -> [f32; 3],
    ) -> Vec<[f32; 3]> {
        let pairs = sets.iter().copied().zip(parts.iter().copied());
        intensity_transfers(radiance, pairs, tone).collect()
    }

    /// What is left of each channel when the marked parts go.
    fn less(from: [f32; 3], parts: &[[f32; 3]], gone: impl Fn(usize) -> bool) -> [f32; 3] {
        std::array::from_fn(|c| {
            let sum: f64 = (0..parts.len()).filter(|&j| gone(j)).map(|j| f64::from(parts[j][c])).sum();
            (f64::from(from[c]) - sum).max(0.0) as f32
        })
    }

    #[test]
    fn the_stated_share_comes_into_the_first_set() {
        let mut rng = SmallRng::seed_from_u64(1);
        for (share, expected) in [(0.5, 25), (0.25, 13), (1.0, 50), (0.0, 0)] {
            let sets = deal(50, share, &mut rng);
            assert_eq!(sets.iter().filter(|s| **s == Set::First).count(), expected, "share {share}");
        }
        assert_ne!(deal(50, 0.5, &mut rng), deal(50, 0.5, &mut rng), "dealt anew");
    }

    #[test]
    fn a_vertex_takes_the_mean_of_the_pixels_around_it() {
        let pixels = [([0, 1, 2], [1.0, 0.0, 0.0], [0.2; 3]), ([0, 1, 2], [0.5, 0.5, 0.0], [0.8; 3])];
        let found = vertex_radiance(3, pixels);
        assert!((found[0][0] - 0.4).abs() < 1e-6 && (found[1][0] - 0.8).abs() < 1e-6, "{found:?}");
        assert_eq!(found[2], [0.0; 3]);
    }

    proptest! {
        #[test]
        fn one_set_hidden_whole_gives_the_exact_code(
            (radiance, parts) in vertex(), share in 0.0f64..=1.0, seed in 0u64..,
        ) {
            let sets = deal(parts.len(), share, &mut SmallRng::seed_from_u64(seed));
            for hidden in [Set::First, Set::Second] {
                let smooth = transfers(radiance, &parts, &sets, srgb);
                let whole = transfers(radiance, &parts, &sets, rounded);
                let left = less(radiance, &parts, |j| sets[j] == hidden);
                let (before, exact) = (srgb(radiance), srgb(left));
                for c in 0..3 {
                    let taken = |of: &[[f32; 3]]| -> f32 {
                        (0..of.len()).filter(|&j| sets[j] == hidden).map(|j| of[j][c]).sum()
                    };
                    prop_assert!((before[c] - taken(&smooth) - exact[c]).abs() < 0.02);
                    // Whole numbers add up without error: only the code of what is left can fall on its other side.
                    let code = rounded(radiance)[c] - taken(&whole);
                    prop_assert!(code.fract() == 0.0 && (code - exact[c]).abs() < 0.52, "{code}, {}", exact[c]);
                }
            }
        }

        #[test]
        fn transfers_and_what_they_leave_are_never_negative(
            (radiance, parts) in vertex(), share in 0.0f64..=1.0, seed in 0u64..,
        ) {
            // Whatever is hidden, also all of both sets: T is concave.
            let sets = deal(parts.len(), share, &mut SmallRng::seed_from_u64(seed));
            let s = transfers(radiance, &parts, &sets, srgb);
            prop_assert!(s.iter().flatten().all(|v| *v >= 0.0));
            for c in 0..3 {
                let all: f32 = s.iter().map(|v| v[c]).sum();
                prop_assert!(srgb(radiance)[c] - all > -0.02);
            }
        }

        #[test]
        fn a_brighter_receiver_stays_brighter(
            (radiance, parts) in vertex(), hidden in prop::collection::vec(any::<bool>(), 60), more in 1.0f32..2.0, seed in 0u64..,
        ) {
            let sets = deal(parts.len(), 0.5, &mut SmallRng::seed_from_u64(seed));
            let brighter = radiance.map(|v| (v * more).min(1.0).max(v));
            let code = |radiance: [f32; 3], c: usize| {
                let s = transfers(radiance, &parts, &sets, srgb);
                let taken: f32 = (0..s.len()).filter(|&j| hidden[j]).map(|j| s[j][c]).sum();
                srgb(radiance)[c] - taken
            };
            for c in 0..3 {
                prop_assert!(code(brighter, c) >= code(radiance, c) - 0.02);
            }
        }
    }
}
