//! What the methods of fitting share: places seen in frames, how far each is trusted, how far a curve is from them.

use super::samples::{Channel, median};
use super::{LEVELS, LN_2};

/// Weight of a place where another channel saturates, against others: it tells of levels that are seen nowhere else.
const MIXED: f64 = 0.05;

/// One place in one frame.
#[derive(Debug, Clone)]
pub(super) struct Observation {
    pub place: usize,
    pub frame: usize,
    /// Level below, and share of the level above.
    pub level: usize,
    pub share: f64,
    pub ln_exposure: f64,
    pub weight: f64,
    /// Robust factor.
    pub trust: f64,
}

impl Observation {
    /// Value of a curve, tabulated at all levels.
    pub fn of(&self, g: &[f64]) -> f64 {
        g[self.level] * (1.0 - self.share) + g[self.level + 1] * self.share
    }
}

/// The observations of some places, by place.
#[derive(Debug, Clone)]
pub(super) struct Observations {
    pub list: Vec<Observation>,
    pub places: usize,
    pub frames: usize,
}

impl Observations {
    /// What is well exposed at the chosen places.
    pub fn new(readings: &Channel, chosen: &[usize], exposures: &[f64]) -> Self {
        let mut list = Vec::new();
        for (place, index) in chosen.iter().enumerate() {
            for (frame, reading) in readings.places[*index].iter().enumerate() {
                if readings.is_good(reading) {
                    let level = (reading.mean as usize).min(LEVELS - 2);
                    let hat = weight(readings, reading.mean);
                    list.push(Observation {
                        place,
                        frame,
                        level,
                        share: reading.mean - level as f64,
                        ln_exposure: exposures[frame].ln(),
                        weight: hat * hat * if reading.mixed { MIXED } else { 1.0 },
                        trust: 1.0,
                    });
                }
            }
        }
        Self { list, places: chosen.len(), frames: exposures.len() }
    }

    /// The same with each place as often as said.
    pub fn repeated(&self, times: &[usize]) -> Self {
        let list = self.list.iter().filter(|o| times[o.place] > 0);
        let weighted =
            |o: &Observation| Observation { weight: o.weight * times[o.place] as f64, ..o.clone() };
        Self { list: list.map(weighted).collect(), ..*self }
    }

    /// Those of some places.
    pub fn only(&self, keep: impl Fn(usize) -> bool) -> Self {
        Self { list: self.list.iter().filter(|o| keep(o.place)).cloned().collect(), ..*self }
    }

    /// Total weight.
    pub fn total(&self) -> f64 {
        self.list.iter().map(|o| o.weight * o.trust).sum()
    }

    /// g(Z) − ln E − ln t at the best ln E of each place.
    pub fn residuals(&self, g: &[f64]) -> Vec<f64> {
        let mut sums = vec![(0.0, 0.0); self.places];
        for o in &self.list {
            let weight = o.weight * o.trust;
            sums[o.place].0 += weight * (o.of(g) - o.ln_exposure);
            sums[o.place].1 += weight;
        }
        let mean = |place: usize| sums[place].0 / f64::max(sums[place].1, 1e-300);
        self.list.iter().map(|o| o.of(g) - o.ln_exposure - mean(o.place)).collect()
    }

    /// Tukey-like weights: an observation three times further off than usual counts half.
    pub fn distrust_outliers(&mut self, g: &[f64]) {
        let residuals = self.residuals(g);
        let sizes = self.list.iter().zip(&residuals).map(|(o, r)| r.abs() * o.weight.sqrt());
        let usual = 1.4826 * median(sizes.filter(|s| *s > 0.0)).unwrap_or(0.0);
        for (o, r) in self.list.iter_mut().zip(residuals) {
            let size = r.abs() * o.weight.sqrt() / (3.0 * usual.max(1e-6));
            o.trust = 1.0 / (1.0 + size.powi(2));
        }
    }

    /// Weighted rms of the residuals, stops, without the robust factor: a frame that is off must show.
    pub fn rms_stops(&self, g: &[f64]) -> f64 {
        let sum = self.list.iter().zip(self.residuals(g)).map(|(o, r)| o.weight * r * r).sum::<f64>();
        let weight: f64 = self.list.iter().map(|o| o.weight).sum();
        (sum / weight.max(1e-300)).sqrt() / LN_2
    }

    /// Median residual of each frame, stops; 0 for a frame that has hardly any observation.
    pub fn frame_stops(&self, g: &[f64]) -> Vec<f64> {
        let residuals = self.residuals(g);
        let of =
            |frame| self.list.iter().zip(&residuals).filter(move |(o, _)| o.frame == frame).map(|(_, r)| *r);
        let stops = |f| if of(f).count() < 10 { 0.0 } else { median(of(f)).unwrap_or(0.0) / LN_2 };
        (0..self.frames).map(stops).collect()
    }
}

/// Half a hat: rises from the black level to the middle as in the paper, since noise in ln exposure falls that way;
/// then stays up, since the bright end fixes the scale, and clipped places have been left out already.
fn weight(readings: &Channel, level: f64) -> f64 {
    let rising = (level - readings.floor) / (0.5 * (readings.clip - readings.floor));
    rising.min(1.0) * ((readings.clip + 2.0 - level) / 12.0).clamp(0.0, 1.0)
}
