//! The two levels of detail (decoro2008, §2.1), and how a time per frame drives both.

/// What a frame may spend on shadows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Detail {
    /// Illumination detail: number of lights that cast shadows.
    pub lights: usize,
    /// Side of the square of pixels that share a sample of the shadow buffer: the sampling detail is 1/`side`².
    pub side: usize,
}

/// Largest side: a sampling detail of 1/1024.
pub const COARSEST: usize = 32;
/// Down to this side shadows lose little (§3.3): it is spent before lights are …
const CHEAP: usize = 4;
/// … and lights, down to so many, before coarser sides (Figure 3).
const FEW_LIGHTS: usize = 15;

/// What parts of a frame cost, from those so far.
#[derive(Debug, Clone, Copy, Default)]
pub struct Pace {
    /// Whatever the detail, s.
    fixed: f64,
    /// A light's map, s.
    map: f64,
    /// A light at a sample, s.
    lookup: f64,
    known: bool,
}

/// Share of the last frame in what is known.
const NEWS: f64 = 0.5;

impl Pace {
    /// Takes note of a frame: what it took for all but maps and samples, for its maps, and for its samples, s.
    pub fn learn(&mut self, detail: Detail, pixels: usize, [fixed, maps, samples]: [f64; 3]) {
        let share = if self.known { NEWS } else { 1.0 };
        let lights = detail.lights.max(1) as f64;
        let lookups = lights * (pixels as f64 / (detail.side * detail.side) as f64).max(1.0);
        self.fixed += share * (fixed - self.fixed);
        self.map += share * (maps / lights - self.map);
        self.lookup += share * (samples / lookups - self.lookup);
        self.known = true;
    }

    /// What a frame is expected to take, s.
    pub fn time(&self, detail: Detail, pixels: usize) -> f64 {
        let samples = pixels as f64 / (detail.side * detail.side) as f64;
        self.fixed + detail.lights as f64 * (self.map + samples * self.lookup)
    }

    /// The most detail, at most that `wanted`, that a frame of so many pixels can have within a time, s: samples are spent
    /// first, then lights, then more samples, at last the last lights; one light is always left. A first frame, about
    /// whose cost nothing is known, gets few lights and samples.
    pub fn choose(&self, seconds: f64, wanted: Detail, pixels: usize) -> Detail {
        if !self.known {
            return Detail { lights: wanted.lights.min(FEW_LIGHTS), side: wanted.side.max(CHEAP) };
        }
        let sides = |from: usize, to: usize| {
            std::iter::successors(Some(from), |s| Some(s * 2)).take_while(move |s| *s <= to)
        };
        let cheap = sides(wanted.side, CHEAP.max(wanted.side)).map(|side| (side, wanted.lights));
        let coarse =
            sides(CHEAP.max(wanted.side), COARSEST).map(|side| (side, wanted.lights.min(FEW_LIGHTS)));
        for (side, least) in cheap.chain(coarse) {
            let affordable = self.lights(seconds, side, pixels);
            if affordable >= least {
                return Detail { lights: affordable.min(wanted.lights), side };
            }
        }
        let side = COARSEST.max(wanted.side);
        Detail { lights: self.lights(seconds, side, pixels).clamp(1, wanted.lights.max(1)), side }
    }

    /// How many lights a time allows, s.
    fn lights(&self, seconds: f64, side: usize, pixels: usize) -> usize {
        let each = self.time(Detail { lights: 1, side }, pixels) - self.fixed;
        if each > 0.0 { ((seconds - self.fixed) / each).max(0.0) as usize } else { usize::MAX }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn detail_settles_within_the_time(
            fixed in 0.0..5e-3f64, map in 1e-5..1e-3f64, lookup in 1e-9..1e-7f64, seconds in 0.01..1.0f64,
            lights in 1usize..500, level in 0u32..5,
        ) {
            let (pixels, wanted) = (300_000, Detail { lights, side: 1 << level });
            let truth = Pace { fixed, map, lookup, known: true };
            let mut pace = Pace::default();
            let mut detail = wanted;
            for _ in 0..4 {
                detail = pace.choose(seconds, wanted, pixels);
                let samples = pixels as f64 / (detail.side * detail.side) as f64;
                let each = [fixed, map * detail.lights as f64, lookup * samples * detail.lights as f64];
                pace.learn(detail, pixels, each);
            }
            prop_assert!(detail.lights <= lights && detail.side >= wanted.side);
            prop_assert!(truth.time(detail, pixels) <= seconds * 1.000_001 || detail.lights == 1, "{:?}", detail);
            let finer = Detail { lights: (detail.lights + 1).min(lights), ..detail };
            prop_assert!(finer == detail || truth.time(finer, pixels) > seconds * 0.999_999, "{:?} leaves time", detail);
        }

        #[test]
        fn more_time_never_gives_fewer_lights_and_samples(seconds in 0.01..0.5f64, more in 1.0..3.0f64) {
            let pace = Pace { fixed: 2e-3, map: 2e-4, lookup: 1e-8, known: true };
            let wanted = Detail { lights: 200, side: 1 };
            let (a, b) = (pace.choose(seconds, wanted, 300_000), pace.choose(seconds * more, wanted, 300_000));
            prop_assert!(b.side <= a.side && (b.side < a.side || b.lights >= a.lights), "{:?} {:?}", a, b);
        }
    }
}
