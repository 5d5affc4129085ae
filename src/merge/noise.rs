//! How far a reading may be off.

use super::Problem;
use super::estimate::{Lane, RUN, Told};
use crate::config;
use crate::exposure::Frame;
use crate::image::CodeImage;
use crate::response::{Curve, LEVELS, Response};
use serde::{Deserialize, Serialize};

/// Variance is tabulated over this many octaves of exposure below [`TOP_OCTAVE`], at so many points in each.
const OCTAVES: i32 = 24;
const TOP_OCTAVE: i32 = 2;
const POINTS: usize = 16;
const ENTRIES: usize = OCTAVES as usize * POINTS;
/// Exposures at both ends of the table: powers of two have no fraction.
const LEAST: f32 = f32::from_bits(((127 + TOP_OCTAVE - OCTAVES) as u32) << 23);
const MOST: f32 = f32::from_bits((((127 + TOP_OCTAVE) as u32) << 23) - 1);
/// Step of an 8-bit code.
const STEP: f32 = 1.0 / (LEVELS - 1) as f32;

/// Noise of one channel, where it saturates at relative exposure 1.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Sensor {
    /// Variance of relative exposure per relative exposure: 1 over the electrons at saturation.
    pub photon: f64,
    /// Variance in the dark: squared read noise over electrons at saturation.
    pub read: f64,
    /// Standard deviation that rounding a code leaves, in steps of 8 bits.
    pub code_steps: f64,
    /// Correlation of the noise of neighbouring pixels. JPEG and cameras smooth noise away, and with it detail of the same
    /// size in all frames alike: an error that averaging does not lessen.
    pub correlation: f64,
}

impl Sensor {
    /// A common camera, for single photographs.
    pub const COMMON: Self = Self::of_electrons(12_000.0, 5.0);

    /// From the full-well capacity and the read noise, electrons; codes of 8 bits.
    pub const fn of_electrons(full_well: f64, read_noise: f64) -> Self {
        let read = read_noise / full_well;
        Self { photon: 1.0 / full_well, read: read * read, code_steps: CODE_STEPS, correlation: 0.0 }
    }

    /// The same with codes whose step is so many steps of 8 bits.
    fn of_step(self, step: f64) -> Self {
        Self { code_steps: CODE_STEPS * step, ..self }
    }

    fn variance(&self, exposure: f64, slope: f64) -> f64 {
        let rounding = slope * f64::from(STEP) * self.code_steps;
        exposure * self.photon + self.read + rounding * rounding
    }

    /// Electrons at saturation.
    pub fn full_well_electrons(&self) -> f64 {
        1.0 / self.photon.max(1e-12)
    }
}

/// Photon, read and quantisation noise of a camera, in relative exposure.
#[derive(Debug, Clone)]
pub struct Noise<'a> {
    response: &'a Response,
    sensors: [Sensor; 3],
    variance: [Vec<f32>; 3],
    /// Inverse of the variance, and the squared relative error that all frames have in common: of the curve, and detail
    /// smoothed away.
    precision: [Vec<(f32, f32)>; 3],
    /// Relative exposures between which a frame is worth reading.
    range: [(f32, f32); 3],
    /// Code from which a channel counts as clipped, and up to which as black.
    clip: [f32; 3],
    floor: [f32; 3],
}

impl<'a> Noise<'a> {
    /// The noise of a camera with this response: as the settings have it, or else as the frames, the shortest exposure
    /// first, show it.
    pub fn new(response: &'a Response, frames: &[Frame], settings: &config::Merge) -> Result<Self, Problem> {
        // The coarsest frame rounds most.
        let bits = frames.iter().map(|f| f.codes.bits()).min().unwrap_or(8);
        let step = (LEVELS - 1) as f64 / f64::from((1_u32 << bits) - 1);
        let sensors = if settings.full_well_electrons > 0.0 {
            let (full_well, read) = (settings.full_well_electrons, settings.read_noise_electrons);
            [Sensor::of_electrons(full_well, read).of_step(step); 3]
        } else {
            estimate(response, frames, step)?
        };
        Ok(Self::of_sensors(response, sensors, step, settings))
    }

    /// `step`: of a code, in steps of 8 bits.
    fn of_sensors(response: &'a Response, sensors: [Sensor; 3], step: f64, settings: &config::Merge) -> Self {
        let step = step as f32 * STEP;
        let curves = response.curves.each_ref();
        let table = |c: usize| {
            let (curve, sensor) = (curves[c], sensors[c]);
            let of = |i: usize| {
                let exposure = exposure_at(i);
                let code = curve.code_of(exposure as f32);
                let slope = f64::from(curve.slope_at(code));
                let error = curve.standard_error_stops(code) * std::f64::consts::LN_2;
                let variance = sensor.variance(exposure, slope);
                // The squared correlation is the share of a pixel's noise that its neighbour tells.
                let smoothed = SMOOTHED * sensor.correlation.powi(2) * variance / (exposure * exposure);
                (variance as f32, (error * error + smoothed) as f32)
            };
            (0..ENTRIES).map(of).unzip::<f32, f32, Vec<_>, Vec<_>>()
        };
        let tables = [table(0), table(1), table(2)];
        let precision = tables.each_ref().map(|(variance, common)| {
            variance.iter().zip(common).map(|(variance, common)| (1.0 / variance, *common)).collect()
        });
        let clip = curves.map(|c| c.clip * settings.clip.min(1.0 - 0.5 * step));
        // Without a black level of its own, code 0 alone says nothing.
        let floor = curves.map(|c| if c.floor > 0.0 { c.floor + 3.0 * STEP } else { 0.5 * step });
        let range =
            [0, 1, 2].map(|c: usize| (curves[c].exposure_of(floor[c]), curves[c].exposure_of(clip[c])));
        let variance = tables.map(|(variance, _)| variance);
        Self { response, sensors, variance, precision, range, clip, floor }
    }

    /// Noise of each channel.
    pub fn sensors(&self) -> &[Sensor; 3] {
        &self.sensors
    }

    /// Variance of the relative exposure read where it is expected to be `exposure`.
    pub fn variance(&self, channel: usize, exposure: f32) -> f32 {
        self.variance[channel][entry(exposure)]
    }

    /// Inverses of that variance, and the squared relative errors that all frames have in common there: of the curve, and of
    /// detail that is smoothed away.
    pub(super) fn precision(&self, channel: usize, exposures: &Lane) -> (Lane, Lane) {
        let table = &self.precision[channel];
        let entries = exposures.map(entry);
        let (mut precision, mut shared) = ([0.0; RUN], [0.0; RUN]);
        for p in 0..RUN {
            (precision[p], shared[p]) = table[entries[p]];
        }
        (precision, shared)
    }

    /// Relative exposures between which a frame is worth reading.
    pub(super) fn range(&self, channel: usize) -> (f32, f32) {
        self.range[channel]
    }

    /// Whether a code counts as clipped.
    pub(super) fn is_clipped(&self, channel: usize, code: f32) -> bool {
        code >= self.clip[channel]
    }

    /// What a frame says at a code. `unit`: radiance at which it has relative exposure 1.
    pub(super) fn told(&self, channel: usize, code: f32, unit: f32) -> Told {
        let exposure = self.response.curves[channel].exposure_of(code);
        let ends = [self.is_clipped(channel, code), code <= self.floor[channel]];
        Told::new(exposure, self.variance(channel, exposure), unit, ends)
    }
}

/// Entry of the tables: octave and sixteenth of an octave stand in the exponent and the first bits of the fraction.
fn entry(exposure: f32) -> usize {
    // Comparisons in this order hold what is no number, too.
    let held = if exposure > LEAST { exposure } else { LEAST };
    let held = if held < MOST { held } else { MOST };
    ((held.to_bits() >> 19) - (LEAST.to_bits() >> 19)) as usize
}

/// Exposure of the middle of an entry of the table.
fn exposure_at(index: usize) -> f64 {
    let octave = (index / POINTS) as i32 + TOP_OCTAVE - OCTAVES;
    (1.0 + ((index % POINTS) as f64 + 0.5) / POINTS as f64) * f64::from(octave).exp2()
}

/// Rows of the frames that are compared.
const ROWS: usize = 128;
/// Bins over ln exposure from 1/1024 of saturation on, and the fewest pixels that one needs.
const BINS: usize = 20;
const FEWEST: usize = 200;
/// Rounding of codes and what JPEG adds to it, steps; too much like photon noise to be told from it.
const CODE_STEPS: f64 = 0.5;

/// Part of that share that is taken for detail lost. All frames lose the same, so that no frame left out tells it: found on
/// rendered captures, where with it each of them has its 68 % of errors within σ, give or take 8.
const SMOOTHED: f64 = 0.5;

/// What the variance of the difference of two frames is in one bin: of exposure x in the shorter one, the longer one
/// gathering 1/r of its light.
struct Bin {
    variance: f64,
    /// Of the step of that difference from a pixel to the next.
    of_steps: f64,
    /// Factors of photon and read noise, and what rounding adds.
    row: [f64; 2],
    rounding: f64,
    count: f64,
}

/// Noise from how far neighbouring exposures differ where both are well exposed: var(x_a − r x_b) = V(x_a) + r² V(x_b), by
/// the deviation that 68 % keep, as σ is of a normal distribution: edges and whatever moved hardly sway it.
fn estimate(response: &Response, frames: &[Frame], step: f64) -> Result<[Sensor; 3], Problem> {
    let height = frames.first().map_or(0, |f| f.codes.size().1);
    let stride = height.div_ceil(ROWS).max(1);
    let mut sampled = Vec::new();
    for frame in frames {
        let rows = (0..height).step_by(stride).map(|y| frame.codes.rows(y..y + 1));
        sampled.push(rows.collect::<Result<Vec<_>, _>>()?);
    }
    Ok([0, 1, 2].map(|channel| {
        let pairs = sampled.windows(2).zip(frames.windows(2));
        let bins: Vec<Bin> = pairs
            .flat_map(|(rows, frames)| {
                let r = frames[0].exposure / frames[1].exposure;
                of_pair([&rows[0], &rows[1]], &response.curves[channel], channel, r, step)
            })
            .collect();
        if bins.len() < 2 { Sensor::COMMON.of_step(step) } else { fitted(&bins).of_step(step) }
    }))
}

/// The bins of two frames, the first of r times the exposure of the second.
fn of_pair(rows: [&[CodeImage]; 2], curve: &Curve, channel: usize, r: f64, step: f64) -> Vec<Bin> {
    let held = curve.floor + 4.0 * STEP..curve.clip - 8.0 * STEP;
    let mut differences = vec![Vec::new(); BINS];
    let mut steps = vec![Vec::new(); BINS];
    for (a, b) in rows[0].iter().zip(rows[1]) {
        // Bin and difference of the pixel before.
        let mut last: Option<(usize, f64)> = None;
        for (p, q) in a.pixels().iter().zip(b.pixels()) {
            let codes = [p.0[channel], q.0[channel]];
            let y = r * f64::from(curve.exposure_of(codes[1]));
            // Binned by the better one, so that noise does not sort the differences.
            let bin = (1.0 + y.log2() / 10.0) * BINS as f64;
            if !codes.iter().all(|c| held.contains(c)) || !(0.0..BINS as f64).contains(&bin) {
                last = None;
                continue;
            }
            let (bin, difference) = (bin as usize, f64::from(curve.exposure_of(codes[0])) - y);
            differences[bin].push(difference);
            if let Some((_, before)) = last.filter(|(b, _)| *b == bin) {
                steps[bin].push(difference - before);
            }
            last = Some((bin, difference));
        }
    }
    let slope = |x: f64| f64::from(curve.slope_at(curve.code_of(x as f32)) * STEP) * CODE_STEPS * step;
    let bins = differences.into_iter().zip(steps).enumerate();
    bins.filter(|(_, (d, s))| d.len() >= FEWEST && s.len() >= FEWEST / 2)
        .map(|(bin, (mut differences, mut steps))| {
            let x = (((bin as f64 + 0.5) / BINS as f64 - 1.0) * 10.0).exp2();
            Bin {
                variance: spread(&mut differences).powi(2),
                of_steps: spread(&mut steps).powi(2),
                row: [x * (1.0 + r), 1.0 + r * r],
                rounding: slope(x).powi(2) + (r * slope(x / r)).powi(2),
                count: differences.len() as f64,
            }
        })
        .collect()
}

/// Deviation from the median that 68 % keep.
fn spread(values: &mut [f64]) -> f64 {
    let middle = values.len() / 2;
    let centre = *values.select_nth_unstable_by(middle, f64::total_cmp).1;
    values.iter_mut().for_each(|v| *v = (*v - centre).abs());
    let within = (0.6827 * values.len() as f64) as usize;
    *values.select_nth_unstable_by(within, f64::total_cmp).1
}

/// Least squares of relative errors with no part below 0, one part at a time until they settle.
fn fitted(bins: &[Bin]) -> Sensor {
    let mut parts = [1.0 / 12_000.0, 1e-7];
    let least = [1e-7, 1e-10];
    for _ in 0..500 {
        for k in 0..2 {
            let (mut top, mut bottom) = (0.0, 1e-300);
            for bin in bins {
                let rest = parts[1 - k] * bin.row[1 - k] + bin.rounding;
                // A bin of many pixels is no better than the model.
                let weight = bin.count.min(5000.0) / bin.variance.max(1e-18).powi(2);
                top += weight * bin.row[k] * (bin.variance - rest);
                bottom += weight * bin.row[k] * bin.row[k];
            }
            parts[k] = (top / bottom).max(least[k]);
        }
    }
    // Of independent pixels a step has twice the variance.
    let shares = bins.iter().map(|b| 1.0 - 0.5 * b.of_steps / b.variance.max(1e-18));
    let correlation = super::median(shares.collect()).unwrap_or(0.0).clamp(0.0, 0.9);
    Sensor { photon: parts[0], read: parts[1], code_steps: CODE_STEPS, correlation }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::{Code, CodeImage, Image};
    use rand::{Rng, SeedableRng, rngs::SmallRng};

    fn noise(response: &Response, full_well: f64) -> Noise<'_> {
        Noise::of_sensors(response, [Sensor::of_electrons(full_well, 5.0); 3], 1.0, &config::Merge::default())
    }

    #[test]
    fn photons_rule_in_the_light_and_reading_in_the_dark() {
        let response = Response::srgb();
        let noise = noise(&response, 12_000.0);
        let read = (5.0_f32 / 12_000.0).powi(2);
        // Half a step of code at the foot of the sRGB curve, whose slope is 1 / 12.92.
        let rounding = (0.5_f32 / 255.0 / 12.92).powi(2);
        for dark in [0.0, -1.0, 1e-9, f32::NAN] {
            assert!((noise.variance(1, dark) / (read + rounding) - 1.0).abs() < 0.05);
        }
        let (low, high) = (noise.variance(1, 0.1), noise.variance(1, 0.9));
        assert!(low > 0.1 / 12_000.0 && high > 0.9 / 12_000.0 && high < 1.3 * 0.9 / 12_000.0, "{low} {high}");
    }

    #[test]
    fn the_table_follows_the_formula() {
        let response = Response::srgb();
        let noise = noise(&response, 1000.0);
        for i in 0..200 {
            let exposure = 1.01_f32.powi(-i * 4);
            let slope = response.curves[0].slope_at(response.curves[0].code_of(exposure));
            let exact = exposure / 1000.0 + 2.5e-5 + (slope * 0.5 / 255.0).powi(2);
            let ratio = noise.variance(0, exposure) / exact;
            assert!((ratio - 1.0).abs() < 0.06, "{exposure}: {ratio}");
        }
    }

    #[test]
    fn noise_is_found_from_the_frames() {
        let response = Response::srgb();
        for full_well in [1500.0, 12_000.0] {
            let mut random = SmallRng::seed_from_u64(3);
            let exposures = [0.25, 0.5, 1.0, 2.0];
            let images: Vec<CodeImage> = exposures
                .iter()
                .map(|e| {
                    Image::from_fn(400, 300, |x, _| {
                        Code(std::array::from_fn(|_| {
                            let light = e * (0.02 + x as f64 / 500.0);
                            let sigma = (light / full_well + (5.0 / full_well).powi(2)).sqrt();
                            let normal: f64 = (0..4).map(|_| random.random_range(-0.866..0.866_f64)).sum();
                            let code = response.code_of([(light + sigma * normal) as f32; 3])[0];
                            (code * 255.0).round() / 255.0
                        }))
                    })
                })
                .collect();
            let frames: Vec<Frame> =
                images.iter().zip(exposures).map(|(codes, exposure)| Frame { codes, exposure }).collect();
            let settings = config::Merge::default();
            let noise = Noise::new(&response, &frames, &settings).unwrap();
            for exposure in [0.05_f32, 0.2, 0.7] {
                let slope = response.curves[0].slope_at(response.curves[0].code_of(exposure));
                let truth = f64::from(exposure) / full_well
                    + (5.0 / full_well).powi(2)
                    + f64::from(slope * STEP).powi(2) / 12.0;
                let ratio = f64::from(noise.variance(1, exposure)) / truth;
                assert!((0.75..1.35).contains(&ratio), "{full_well} {exposure}: {ratio}");
            }
        }
    }
}
