//! Where to sample the brackets: flat places, spread over the image and over the range of light.

use super::{LEVELS, TOP, linear_from_srgb};
use crate::exposure::Frame;
use crate::image::CodeImage;
use rand::{SeedableRng, rngs::SmallRng, seq::SliceRandom};

/// Side of a place, px. Its mean is sampled: that lessens noise, JPEG artefacts and a shift of the tripod.
const SIDE: usize = 5;
/// Places are laid on a grid of at most so many.
const MOST_PLACES: usize = 20_000;
/// Bins over ln radiance.
const BINS: usize = 24;
/// So many places of a bin are used however uneven they are.
const FEWEST_OF_A_BIN: usize = 4;
/// Tiles along each side of the image.
const TILES: usize = 8;

/// One place in one frame and channel, in levels.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Reading {
    pub mean: f64,
    /// The least and the largest of its pixels.
    pub low: f64,
    pub high: f64,
    /// Another channel saturates there: a camera that mixes channels for colour then strays from its curve.
    pub mixed: bool,
}

/// What a fit takes from a frame: readings at a grid of places, and how often each level occurs.
#[derive(Debug, Clone)]
pub struct Sampled {
    pub(super) size: (usize, usize),
    /// [`crate::exposure::Exposure::scale`].
    pub exposure: f64,
    /// By channel, then place.
    pub(super) readings: [Vec<Reading>; 3],
    tiles: Vec<usize>,
    counts: [Vec<usize>; 3],
}

impl Sampled {
    /// Reads a frame, a band of rows at a time.
    pub fn new(frame: &Frame) -> std::io::Result<Self> {
        let (width, height) = frame.codes.size();
        let stride = ((width * height / MOST_PLACES) as f64).sqrt().ceil().max(SIDE as f64) as usize;
        let mut sampled = Self {
            size: (width, height),
            exposure: frame.exposure,
            readings: Default::default(),
            tiles: Vec::new(),
            counts: [0; 3].map(|_| vec![0; LEVELS]),
        };
        for y in (0..height).step_by(stride) {
            // The rows of the places tell of all.
            let band = frame.codes.rows(y..(y + SIDE).min(height))?;
            for pixel in band.pixels() {
                for (counts, code) in sampled.counts.iter_mut().zip(pixel.0) {
                    counts[((code * TOP as f32 + 0.5) as usize).min(LEVELS - 1)] += 1;
                }
            }
            if band.height() < SIDE {
                break;
            }
            for x in (0..(width + 1).saturating_sub(SIDE)).step_by(stride) {
                for (channel, readings) in sampled.readings.iter_mut().enumerate() {
                    readings.push(reading(&band, channel, x));
                }
                sampled.tiles.push(y * TILES / height * TILES + x * TILES / width);
            }
        }
        Ok(sampled)
    }
}

/// What one channel shows at all places, and between which levels it can be trusted.
pub(super) struct Channel {
    /// Readings by place, then frame.
    pub places: Vec<Vec<Reading>>,
    tiles: Vec<usize>,
    /// Black level.
    pub floor: f64,
    /// Level from which readings count.
    pub lowest: f64,
    /// Level of saturation.
    pub clip: f64,
}

impl Channel {
    /// A channel of frames of one size, in order of rising exposure.
    pub fn new(frames: &[&Sampled], channel: usize) -> Self {
        let tiles = frames[0].tiles.clone();
        let clips = [0, 1, 2].map(|c| saturation(frames, c));
        let mixed = |f: &Sampled, place: usize| {
            (0..3).any(|c| c != channel && f.readings[c][place].high >= clips[c] - 0.5)
        };
        let of = |place: usize| {
            let read = |f: &&Sampled| Reading { mixed: mixed(f, place), ..f.readings[channel][place] };
            frames.iter().map(read).collect()
        };
        let places: Vec<Vec<Reading>> = (0..tiles.len()).map(of).collect();
        let exposures: Vec<f64> = frames.iter().map(|f| f.exposure).collect();
        let clip = clips[channel];
        let (floor, noise) = black_level(&places, &exposures);
        Self { places, tiles, floor, lowest: floor + (4.0 * noise).max(5.0), clip }
    }

    /// Whether a reading tells an exposure: no pixel clipped, none lost in the black.
    pub fn is_good(&self, reading: &Reading) -> bool {
        reading.high < self.clip - 0.5 && reading.mean > self.lowest
    }

    /// Whether all of a place is saturated.
    pub fn is_clipped(&self, reading: &Reading) -> bool {
        reading.high >= self.clip - 0.5
    }

    /// Chooses places: from each bin of radiance and each tile of the image in turn, among the flatter half.
    pub fn choose(&self, exposures: &[f64], count: usize, seed: u64) -> Vec<usize> {
        let candidates: Vec<(usize, f64, f64)> = self
            .places
            .iter()
            .enumerate()
            .filter(|(_, place)| self.distinct(place, exposures) >= 2)
            .map(|(i, place)| (i, self.rough_ln_radiance(place, exposures), self.unevenness(place)))
            .collect();
        let (low, high) =
            candidates.iter().fold((f64::MAX, f64::MIN), |(l, h), (_, r, _)| (l.min(*r), h.max(*r)));
        let mut binned: Vec<Vec<(f64, usize)>> = vec![Vec::new(); BINS];
        for (i, radiance, unevenness) in candidates {
            let share = (radiance - low) / (high - low).max(1e-9);
            binned[((share * BINS as f64) as usize).min(BINS - 1)].push((unevenness, i));
        }
        let by_unevenness = |a: &(f64, usize), b: &(f64, usize)| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1));
        let mut random = SmallRng::seed_from_u64(seed);
        let mut cells: Vec<Vec<(f64, usize)>> = vec![Vec::new(); BINS * TILES * TILES];
        for (bin, mut places) in binned.into_iter().enumerate() {
            places.sort_by(by_unevenness);
            // Edges, and whatever moved, are in the unevener half.
            places.truncate(places.len().div_ceil(2).max(FEWEST_OF_A_BIN));
            // Among those any is as good as another.
            places.shuffle(&mut random);
            places.into_iter().for_each(|p| cells[bin * TILES * TILES + self.tiles[p.1]].push(p));
        }
        let mut bins: Vec<std::vec::IntoIter<usize>> =
            cells.chunks(TILES * TILES).map(|tiles| in_turn(tiles).into_iter()).collect();
        let mut chosen = Vec::new();
        while chosen.len() < count {
            let before = chosen.len();
            chosen.extend(bins.iter_mut().filter_map(Iterator::next));
            if chosen.len() == before {
                break;
            }
        }
        chosen.truncate(count);
        chosen
    }

    fn distinct(&self, place: &[Reading], exposures: &[f64]) -> usize {
        let mut last = 0.0;
        let good = place.iter().zip(exposures).filter(|(r, _)| self.is_good(r));
        good.filter(|(_, e)| **e > 1.01 * std::mem::replace(&mut last, **e)).count()
    }

    /// ln radiance by a typical curve, good enough for binning.
    fn rough_ln_radiance(&self, place: &[Reading], exposures: &[f64]) -> f64 {
        let good = place.iter().zip(exposures).filter(|(r, _)| self.is_good(r));
        let (sum, weight) = good.fold((0.0, 0.0), |(sum, weight), (r, e)| {
            (sum + r.mean * (linear_from_srgb(r.mean / TOP) / e).ln(), weight + r.mean)
        });
        sum / weight.max(1e-9)
    }

    /// Range of levels within the place against its mean, in its worst good frame: a place that is flat in one frame
    /// may have moved in another. In the dark the range is noise.
    fn unevenness(&self, place: &[Reading]) -> f64 {
        let good = place.iter().filter(|r| self.is_good(r));
        good.map(|r| (r.high - r.low) / (r.mean - self.floor + 20.0)).fold(0.0, f64::max)
    }
}

/// The first of every cell, then the second of every cell, and so on.
fn in_turn(cells: &[Vec<(f64, usize)>]) -> Vec<usize> {
    let deepest = cells.iter().map(Vec::len).max().unwrap_or(0);
    (0..deepest).flat_map(|rank| cells.iter().filter_map(move |c| c.get(rank).map(|(_, i)| *i))).collect()
}

fn reading(band: &CodeImage, channel: usize, x: usize) -> Reading {
    let (mut sum, mut low, mut high) = (0.0, f64::MAX, f64::MIN);
    for v in 0..SIDE {
        for u in x..x + SIDE {
            let z = f64::from(band.at(u, v).0[channel]) * TOP;
            (sum, low, high) = (sum + z, low.min(z), high.max(z));
        }
    }
    Reading { mean: sum / (SIDE * SIDE) as f64, low, high, mixed: false }
}

/// Level at which the channel saturates: the largest, if codes pile up there, or else the largest possible.
fn saturation(frames: &[&Sampled], channel: usize) -> f64 {
    let of = |level| frames.iter().map(|f| f.counts[channel][level]).sum();
    let counts: Vec<usize> = (0..LEVELS).map(of).collect();
    let Some(largest) = counts.iter().rposition(|c| *c > 0) else { return TOP };
    let all: usize = counts.iter().sum();
    let neighbours = counts[largest.saturating_sub(8)..largest].iter().max().copied().unwrap_or(0);
    let piled = counts[largest] > 3 * neighbours && counts[largest] * 1000 > all;
    if piled && largest > LEVELS / 2 { largest as f64 } else { TOP }
}

/// Black level and its noise, levels: what the darkest places show, where longer exposure does not lift it.
fn black_level(places: &[Vec<Reading>], exposures: &[f64]) -> (f64, f64) {
    let Some(second) = exposures.iter().position(|e| *e > 1.3 * exposures[0]) else { return (0.0, 0.0) };
    let last = exposures.len() - 1;
    // Places that never change (a painted border) tell nothing.
    let mut changing: Vec<&Vec<Reading>> = places.iter().filter(|p| p[last].mean > p[0].mean + 2.0).collect();
    changing.sort_by(|a, b| a[last].mean.total_cmp(&b[last].mean));
    changing.truncate(places.len() / 20);
    let Some(level) = median(changing.iter().map(|p| p[0].mean)) else { return (0.0, 0.0) };
    let lifted = median(changing.iter().map(|p| p[second].mean - p[0].mean)).unwrap_or(0.0);
    if level < 1.0 || lifted > 2.0 {
        return (0.0, 0.0);
    }
    // The range of a place's 25 pixels spans about four standard deviations.
    (level, median(changing.iter().map(|p| (p[0].high - p[0].low) / 4.0)).unwrap_or(0.0))
}

/// Median; `None` of nothing.
pub(super) fn median(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.collect();
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}
