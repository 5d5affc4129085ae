//! Merging a band of rows at a time.

use super::estimate::{Estimate, RUN, Run, Told};
use super::ghosts;
use super::noise::{Noise, Sensor};
use super::order::by_exposure;
use super::residuals::Residuals;
use super::{Merged, Problem};
use crate::config;
use crate::exposure::{Frame, Strip};
use crate::image::{Image, Radiance};
use crate::response::{LEVELS, Response, Vignetting};
use rayon::prelude::*;
use std::ops::Range;
use std::sync::LazyLock;

/// Pixels of a band.
const PIXELS: usize = 1 << 17;

/// Rows of a merged view.
#[derive(Debug, Clone)]
pub struct Band {
    /// Its first row in the view, px.
    pub top: usize,
    /// Radiance, variance, clipping.
    pub merged: Merged,
    /// Frames left out at each pixel since they see something else, one bit for each of the first 64 that were given.
    pub left_out: Image<u64>,
}

/// What came out for one frame.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct FrameFigures {
    /// Median of |log2 (frame / merged)| over the pixels that are well exposed in it, stops; 0 where there are none.
    /// Noise, wrong exposures, motion all show.
    pub residual_stops: f64,
    /// Share of its pixels that saturate in a channel.
    pub clipped_share: f64,
    /// Share of the pixels at which it is left out.
    pub left_out_share: f64,
}

/// What came out as a whole.
#[derive(Debug, Clone, PartialEq)]
pub struct Summary {
    /// By frame, in the order given.
    pub frames: Vec<FrameFigures>,
    /// For each of them where it differs from the merged picture and by how many stops: means over cells of a picture of at
    /// most 240 px width, 0 where it is not well exposed.
    pub residuals: Vec<Image<f32>>,
    /// Noise that was reckoned with, per channel.
    pub sensors: [Sensor; 3],
    /// Share of pixels that saturate in every frame.
    pub clipped_share: f64,
    /// Median standard error over radiance of the green channel, over pixels that are not clipped.
    pub median_relative_error: f64,
}

/// Merges frames of one view and size and hands the bands on from the top down; memory grows with the width and the
/// count of frames, not with the height. `plate_exposure` sets the unit. The order of the frames makes no difference.
pub fn merge_in_bands<E: From<Problem>>(
    frames: &[Frame],
    response: &Response,
    plate_exposure: f64,
    settings: &config::Merge,
    mut take: impl FnMut(Band) -> Result<(), E>,
) -> Result<Summary, E> {
    let (width, height) = check(frames, plate_exposure)?;
    let order = by_exposure(frames).map_err(Problem::from)?;
    let frames: Vec<Frame> = order.iter().map(|i| frames[*i]).collect();
    let noise = Noise::new(response, &frames, settings)?;
    // Radiance at which each frame has relative exposure 1.
    let units: Vec<f32> = frames.iter().map(|f| (plate_exposure / f.exposure) as f32).collect();
    let view = View {
        told: units.iter().map(|unit| AtCodes::new(&noise, *unit)).collect(),
        noise,
        units,
        size: (width, height),
        vignetting: response.vignetting.as_ref(),
        deghost: settings.deghost && frames.len() > 2,
        frames,
        order,
    };
    let rows = (PIXELS / width.max(1)).clamp(1, height.max(1));
    let tops: Vec<usize> = (0..height).step_by(rows).collect();
    let mut counts = Counts::new(view.frames.len(), width, 0..height);
    for group in tops.chunks(rayon::current_num_threads()) {
        let bands: Vec<_> = group.par_iter().map(|top| view.band(*top..(top + rows).min(height))).collect();
        for band in bands {
            let (band, of_band) = band?;
            counts.add(&of_band);
            take(band)?;
        }
    }
    Ok(counts.summary(&view))
}

fn check(frames: &[Frame], plate_exposure: f64) -> Result<(usize, usize), Problem> {
    let first = frames.first().ok_or(Problem::NoFrame)?.codes.size();
    for (i, frame) in frames.iter().enumerate() {
        if frame.codes.size() != first {
            return Err(Problem::Sizes { frame: i + 1, size: frame.codes.size(), first });
        }
    }
    for exposure in frames.iter().map(|f| f.exposure).chain([plate_exposure]) {
        if !(exposure.is_finite() && exposure > 0.0) {
            return Err(Problem::Exposure { exposure });
        }
    }
    Ok(first)
}

struct View<'a> {
    /// From the shortest exposure on.
    frames: Vec<Frame<'a>>,
    /// Where each of them stood among those given.
    order: Vec<usize>,
    noise: Noise<'a>,
    units: Vec<f32>,
    told: Vec<AtCodes>,
    size: (usize, usize),
    vignetting: Option<&'a Vignetting>,
    deghost: bool,
}

/// What a frame says at each code of 8 bits, since most codes are such.
struct AtCodes {
    unit: f32,
    channels: [Box<[Told; LEVELS]>; 3],
}

impl AtCodes {
    fn new(noise: &Noise, unit: f32) -> Self {
        let table = |channel| Box::new(CODES.map(|code| noise.told(channel, code, unit)));
        Self { unit, channels: [0, 1, 2].map(table) }
    }

    fn of(&self, noise: &Noise, channel: usize, code: f32) -> Told {
        let z = ((code * (LEVELS - 1) as f32 + 0.5) as usize).min(LEVELS - 1);
        if code.is_nan() {
            Told::NOTHING
        } else if CODES[z] == code {
            self.channels[channel][z]
        } else {
            noise.told(channel, code, self.unit)
        }
    }
}

/// All codes of 8 bits.
static CODES: LazyLock<[f32; LEVELS]> =
    LazyLock::new(|| std::array::from_fn(|z| z as f32 / (LEVELS - 1) as f32));

impl View<'_> {
    fn band(&self, rows: Range<usize>) -> Result<(Band, Counts), Problem> {
        let margin = if self.deghost { ghosts::MARGIN } else { 0 };
        let wider = rows.start.saturating_sub(margin)..(rows.end + margin).min(self.size.1);
        let strips = self.frames.iter().map(|f| f.codes.strip(wider.clone()));
        let strips = strips.collect::<Result<Vec<Strip>, _>>()?;
        let (width, all) = (self.size.0, wider.len() * self.size.0);
        let mut run = Run::new(&self.noise, &self.units);
        let mut estimates = vec![[Estimate::default(); 3]; all];
        let mut seen = vec![0; if self.deghost { all } else { 0 }];
        for first in (0..all).step_by(RUN) {
            let pixels = first..(first + RUN).min(all);
            let indices: Vec<usize> = pixels.clone().collect();
            for channel in 0..3 {
                self.read(&mut run, &strips, channel, &indices);
                run.estimate(channel);
                for (p, estimated) in estimates[pixels.clone()].iter_mut().enumerate() {
                    estimated[channel] = run.at(p, channel);
                }
                if self.deghost {
                    let suspect = run.suspect(channel);
                    let seen = seen[pixels.clone()].iter_mut().zip(suspect).enumerate();
                    seen.filter(|(_, (_, s))| *s)
                        .for_each(|(p, (bits, _))| *bits |= run.inconsistent(p, channel));
                }
            }
        }
        let inner = (rows.start - wider.start) * width..(rows.end - wider.start) * width;
        let left_out = if seen.iter().any(|bits| *bits != 0) {
            let wanted = ghosts::mask(&Image::from_pixels(width, wider.len(), seen)).into_pixels();
            self.leave_out(&mut run, &strips, &wanted[inner.clone()], inner.start, &mut estimates)
        } else {
            vec![0; inner.len()]
        };
        Ok(self.finish(&strips, rows, inner, &estimates, left_out))
    }

    /// Estimates pixels again without the frames that their surroundings want left out, and says which those are. None where
    /// all others are saturated and these say that there is more, which agrees: around a small light JPEG rings in frames
    /// that are black otherwise.
    fn leave_out(
        &self,
        run: &mut Run,
        strips: &[Strip],
        wanted: &[u64],
        first: usize,
        estimates: &mut [[Estimate; 3]],
    ) -> Vec<u64> {
        let mut left_out = wanted.to_vec();
        let with_ghosts: Vec<usize> =
            (first..first + wanted.len()).filter(|i| wanted[i - first] != 0).collect();
        for pixels in with_ghosts.chunks(RUN) {
            let without = [0, 1, 2].map(|channel| {
                self.read(run, strips, channel, pixels);
                pixels.iter().enumerate().for_each(|(p, i)| run.leave_out(p, wanted[i - first]));
                run.estimate(channel);
                std::array::from_fn::<_, RUN, _>(|p| run.at(p, channel))
            });
            for (p, i) in pixels.iter().enumerate() {
                let (without, all) = (without.map(|channel| channel[p]), &mut estimates[*i]);
                let agrees = |(rest, all): (&Estimate, &Estimate)| {
                    rest.clipped && !all.clipped && all.radiance > rest.radiance
                };
                if without.iter().zip(all.iter()).any(agrees) {
                    left_out[i - first] = 0;
                } else {
                    *all = without;
                }
            }
        }
        left_out
    }

    /// The band of what was estimated, `inner` of it, seen before the lens.
    fn finish(
        &self,
        strips: &[Strip],
        rows: Range<usize>,
        inner: Range<usize>,
        estimates: &[[Estimate; 3]],
        left_out: Vec<u64>,
    ) -> (Band, Counts) {
        let width = self.size.0;
        let mut counts = Counts::new(self.frames.len(), width, rows.clone());
        let mut merged = Merged {
            radiance: Image::filled(width, rows.len(), Radiance::default()),
            variance: Image::filled(width, rows.len(), [0.0; 3]),
            clipped: Image::filled(width, rows.len(), false),
        };
        let Merged { radiance, variance, clipped } = &mut merged;
        let (radiance, variance, clipped) =
            (radiance.pixels_mut(), variance.pixels_mut(), clipped.pixels_mut());
        for (to, (i, without)) in inner.zip(&left_out).enumerate() {
            let (x, y) = (to % width, rows.start + to / width);
            let fall_off = self.vignetting.map(|v| v.of_pixel(x, y, self.size));
            for (channel, estimated) in estimates[i].iter().enumerate() {
                let estimated = fall_off.map_or(*estimated, |f| estimated.through(f));
                radiance[to].0[channel] = estimated.radiance;
                variance[to][channel] = estimated.variance;
                clipped[to] |= estimated.clipped;
            }
            counts.pixel(self, strips, (x, y), i, &estimates[i], *without);
        }
        let left_out = left_out.into_iter().map(|bits| self.as_given(bits)).collect();
        let left_out = Image::from_pixels(width, rows.len(), left_out);
        (Band { top: rows.start, merged, left_out }, counts)
    }

    /// Bits of frames in the order in which they were given.
    fn as_given(&self, bits: u64) -> u64 {
        if bits == 0 {
            return 0;
        }
        let set =
            self.order.iter().take(64).enumerate().filter(|(i, given)| bits & 1 << i != 0 && **given < 64);
        set.fold(0, |bits, (_, given)| bits | 1 << given)
    }

    /// What all frames say of a channel of some pixels.
    fn read(&self, run: &mut Run, strips: &[Strip], channel: usize, pixels: &[usize]) {
        for (frame, (strip, told)) in strips.iter().zip(&self.told).enumerate() {
            match strip {
                Strip::Eight(samples) => {
                    let (samples, table) = (&samples[channel..], &*told.channels[channel]);
                    run.put(frame, pixels.iter().map(|i| table[usize::from(samples[3 * i])]));
                }
                _ => {
                    let code = |i: &usize| told.of(&self.noise, channel, strip.code(*i, channel));
                    run.put(frame, pixels.iter().map(code));
                }
            }
        }
    }
}

/// Figures gathered over pixels. Medians are taken from histograms, so that they need no memory of all pixels.
struct Counts {
    pixels: usize,
    /// Of which the frames' own figures are taken.
    sampled: usize,
    clipped: usize,
    /// Relative standard errors, in steps of 0.05 %.
    errors: Vec<u32>,
    frames: Vec<FrameCounts>,
    residuals: Residuals,
}

#[derive(Clone)]
struct FrameCounts {
    /// |log2 ratio|, in steps of 1/500 stop.
    residuals: Vec<u32>,
    clipped: usize,
    left_out: usize,
}

const ERROR_STEP: f64 = 5e-4;
const RESIDUAL_STEP: f64 = 2e-3;
const STEPS: usize = 2000;

impl Counts {
    fn new(frames: usize, width: usize, rows: Range<usize>) -> Self {
        let frame = FrameCounts { residuals: vec![0; STEPS], clipped: 0, left_out: 0 };
        let residuals = Residuals::new(frames, width, rows);
        let (errors, frames) = (vec![0; STEPS], vec![frame; frames]);
        Self { pixels: 0, sampled: 0, clipped: 0, errors, frames, residuals }
    }

    /// Of the pixel at a place of the view, the `i`-th of the strips.
    fn pixel(
        &mut self,
        view: &View,
        strips: &[Strip],
        (x, y): (usize, usize),
        i: usize,
        estimates: &[Estimate; 3],
        without: u64,
    ) {
        self.pixels += 1;
        let clipped = estimates.iter().any(|e| e.clipped);
        self.clipped += usize::from(clipped);
        let green = &estimates[1];
        if !clipped && green.radiance > 0.0 {
            self.errors[step(f64::from(green.variance.sqrt() / green.radiance), ERROR_STEP)] += 1;
        }
        if without != 0 {
            for (frame, counts) in self.frames.iter_mut().enumerate().take(64) {
                counts.left_out += usize::from(without & 1 << frame != 0);
            }
        }
        // Some of the pixels tell of each frame.
        if !i.is_multiple_of(self.residuals.stride()) {
            return;
        }
        self.sampled += 1;
        for (frame, counts) in self.frames.iter_mut().enumerate() {
            let strip = &strips[frame];
            counts.clipped += usize::from((0..3).any(|c| view.noise.is_clipped(c, strip.code(i, c))));
            // Green alone: it has the least noise and is the same in JPEG's subsampled colour.
            let code = strip.code(i, 1);
            if (0.2..0.9).contains(&code) && green.radiance > 0.0 {
                let stops = (view.told[frame].of(&view.noise, 1, code).says / green.radiance).log2();
                counts.residuals[step(f64::from(stops.abs()), RESIDUAL_STEP)] += 1;
                self.residuals.put(frame, x, y, stops);
            }
        }
    }

    fn add(&mut self, other: &Self) {
        let add = |a: &mut [u32], b: &[u32]| a.iter_mut().zip(b).for_each(|(a, b)| *a += b);
        self.pixels += other.pixels;
        self.sampled += other.sampled;
        self.clipped += other.clipped;
        add(&mut self.errors, &other.errors);
        self.residuals.add(&other.residuals);
        for (a, b) in self.frames.iter_mut().zip(&other.frames) {
            add(&mut a.residuals, &b.residuals);
            a.clipped += b.clipped;
            a.left_out += b.left_out;
        }
    }

    fn summary(&self, view: &View) -> Summary {
        let share = |n: usize| n as f64 / self.pixels.max(1) as f64;
        let of = |f: &FrameCounts| FrameFigures {
            residual_stops: middle(&f.residuals, RESIDUAL_STEP),
            clipped_share: f.clipped as f64 / self.sampled.max(1) as f64,
            left_out_share: share(f.left_out),
        };
        let mut frames = vec![FrameFigures::default(); self.frames.len()];
        let mut residuals = vec![Image::from_pixels(0, 0, Vec::new()); self.frames.len()];
        for (i, (counts, given)) in self.frames.iter().zip(&view.order).enumerate() {
            frames[*given] = of(counts);
            residuals[*given] = self.residuals.map(i);
        }
        Summary {
            frames,
            residuals,
            sensors: *view.noise.sensors(),
            clipped_share: share(self.clipped),
            median_relative_error: middle(&self.errors, ERROR_STEP),
        }
    }
}

fn step(value: f64, size: f64) -> usize {
    ((value / size) as usize).min(STEPS - 1)
}

/// Median of a histogram; 0 of nothing.
fn middle(counts: &[u32], size: f64) -> f64 {
    let all: u64 = counts.iter().map(|c| u64::from(*c)).sum();
    let mut sum = 0;
    let at = counts.iter().position(|c| {
        sum += u64::from(*c);
        all > 0 && 2 * sum >= all
    });
    at.map_or(0.0, |k| (k as f64 + 0.5) * size)
}
