//! Whether a curve stays within its own band whatever it was fitted to.

use super::errors::CODES;
use super::subject::Subject;
use crate::config;
use crate::exposure::Frame;
use crate::image::{Code, CodeImage, Image};
use crate::printer::Printer;
use crate::response::{Response, fit};

/// All places that there are.
const ALL: usize = 100_000;
/// Triples of exposures at most, spread over all there are.
const TRIPLES: usize = 20;
const SEEDS: u64 = 20;
/// Standard errors that a 95 % band reaches to either side.
const BAND: f64 = 1.96;

/// What became of some fits.
#[derive(Default)]
struct Tally {
    fits: usize,
    refused: usize,
    /// Largest departure from the reference, stops.
    largest: f64,
    inside: usize,
    levels: usize,
}

impl Tally {
    /// Adds a fit against the reference: channels apart, one factor free, since the unit is.
    fn add(&mut self, fitted: Option<&Response>, reference: &Response) {
        let Some(fitted) = fitted else {
            self.refused += 1;
            return;
        };
        self.fits += 1;
        for (a, b) in fitted.curves.iter().zip(&reference.curves) {
            let departure = |z: usize| (a.exposure[z] / b.exposure[z]).log2();
            let mean = CODES.map(departure).sum::<f64>() / CODES.count() as f64;
            for z in CODES {
                let band = BAND * a.standard_error[z].hypot(b.standard_error[z]) / std::f64::consts::LN_2;
                let off = (departure(z) - mean).abs();
                self.largest = self.largest.max(off);
                self.inside += usize::from(off <= band);
                self.levels += 1;
            }
        }
    }

    fn tell(&self, what: &str, printer: &Printer) {
        let share = 100.0 * self.inside as f64 / self.levels.max(1) as f64;
        printer.data(&format!(
            "{what:<24}{:>6}{:>9}{:>16.3}{share:>14.1} %",
            self.fits, self.refused, self.largest
        ));
    }
}

/// Prints a line for each way of choosing what the curve is fitted to.
pub(super) fn print(subject: &Subject, printer: &Printer) {
    printer.data(&format!(
        "\n{}: curves against that from all samples; codes {}-{}, one factor a channel free; 95 % bands of both together\n{:<24}{:>6}{:>9}{:>16}{:>16}",
        subject.name, CODES.start(), CODES.end(), "fitted to", "fits", "refused", "largest, stops", "within band"
    ));
    let with = |frames: &[Frame], samples, seed| {
        fit(frames, &config::Response { samples, seed, ..Default::default() }).ok()
    };
    let frames = subject.frames();
    let Some(reference) = with(&frames, ALL, 0) else {
        return printer.data("the curve from all samples is refused");
    };
    for samples in [50, 200, 1000] {
        let mut tally = Tally::default();
        tally.add(with(&frames, samples, 0).as_ref(), &reference);
        tally.tell(&format!("{samples} samples"), printer);
    }
    let mut tally = Tally::default();
    let halves: Vec<CodeImage> = subject.images.iter().map(halved).collect();
    let half: Vec<Frame> =
        (halves.iter().zip(&subject.exposures)).map(|(codes, e)| Frame { codes, exposure: *e }).collect();
    tally.add(with(&half, 1000, 0).as_ref(), &reference);
    tally.tell("half the size", printer);
    let n = frames.len();
    let triples: Vec<[usize; 3]> =
        (0..n).flat_map(|a| (a + 1..n).flat_map(move |b| (b + 1..n).map(move |c| [a, b, c]))).collect();
    let mut tally = Tally::default();
    for triple in triples.iter().step_by(triples.len().div_ceil(TRIPLES).max(1)) {
        let some: Vec<Frame> = triple.iter().map(|i| frames[*i]).collect();
        tally.add(with(&some, 1000, 0).as_ref(), &reference);
    }
    tally.tell("3 of the exposures", printer);
    let mut tally = Tally::default();
    (1..=SEEDS).for_each(|seed| tally.add(with(&frames, 200, seed).as_ref(), &reference));
    tally.tell("200 samples, 20 seeds", printer);
}

/// Means of codes over 2 × 2 px.
fn halved(image: &CodeImage) -> CodeImage {
    Image::from_fn(image.width() / 2, image.height() / 2, |x, y| {
        let four = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(u, v)| image.at(2 * x + u, 2 * y + v).0);
        Code(std::array::from_fn(|k| four.iter().map(|c| c[k]).sum::<f32>() / 4.0))
    })
}
