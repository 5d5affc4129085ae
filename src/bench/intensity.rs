//! The experiment of gibson's Figure 3: how far intensity transfers are from the exact code, by the number of sources
//! that are occluded, for sets of different sizes.

use super::plot::{self, Axis, Line, Panel};
use super::statics::Static;
use crate::artefact::json;
use crate::error::{FileContext, Result};
use crate::image::luminance;
use crate::printer::Printer;
use crate::response::Response;
use crate::shadow::Bounds;
use crate::shadow::intensity::{TOP, deal, intensity_transfers, vertex_radiance};
use crate::stage::Workspace;
use rand::rngs::SmallRng;
use rand::seq::SliceRandom;
use rand::{Rng, SeedableRng};
use rayon::prelude::*;
use std::fmt::Write as _;
use std::path::Path;

/// Sources of a trial: as many as the passes of the paper's frames.
const SOURCES: usize = 50;
/// Trials for each data set and number of occluded sources.
const TRIALS: usize = 10_000;
/// Trials that one random stream makes.
const CHUNK: usize = 250;
/// Receiver vertices of a capture: those nearest to the object.
const VERTICES: usize = 16;
/// Share of occlusion that the paper finds near objects, as numbers of [`SOURCES`].
const TYPICAL: std::ops::RangeInclusive<usize> = 15..=25;

/// How sources are dealt and codes kept.
struct Variant {
    name: &'static str,
    first_share: f64,
    codes: Codes,
}

/// Whether codes are whole numbers.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Codes {
    /// They are not: what the sets alone cost.
    Smooth,
    /// The vertex's codes are, hence their differences.
    Whole,
    /// Each transfer is, rounded on its own.
    RoundedTransfers,
}

/// Those of the paper's figure first.
const VARIANTS: [Variant; 5] = [
    Variant { name: "50/50", first_share: 0.5, codes: Codes::Smooth },
    Variant { name: "25/75", first_share: 0.25, codes: Codes::Smooth },
    Variant { name: "all", first_share: 1.0, codes: Codes::Smooth },
    Variant { name: "50/50, whole codes", first_share: 0.5, codes: Codes::Whole },
    Variant { name: "50/50, rounded transfers", first_share: 0.5, codes: Codes::RoundedTransfers },
];
/// How many of the variants are the paper's.
const PAPERS: usize = 3;

/// Receivers of one scene.
struct DataSet {
    name: String,
    response: Response,
    receivers: Vec<Receiver>,
}

/// A receiver vertex: its radiance, and the part that each source has in it, by decreasing average transfer.
struct Receiver {
    radiance: [f32; 3],
    transfers: Vec<[f32; 3]>,
}

/// Sums over trials of the error and of its square, code values, by occluded sources and channel.
#[derive(Clone)]
struct Errors {
    trials: f64,
    sums: Vec<[[f64; 2]; 3]>,
}

/// Prints mean errors and squared errors, writes `intensity.csv` and `intensity.svg` into `pictures`, or else into `bench`
/// of the first work folder.
pub(super) fn print(workspaces: &[Workspace], pictures: Option<&Path>, printer: &Printer) -> Result<()> {
    let mut sets = workspaces.iter().map(DataSet::read).collect::<Result<Vec<_>>>()?;
    sets.push(DataSet::synthetic());
    sets.retain(|s| !s.receivers.is_empty());
    let found: Vec<Vec<Errors>> =
        VARIANTS.iter().map(|v| sets.iter().map(|s| s.errors(v, TRIALS)).collect()).collect();
    let pooled: Vec<Errors> = found.iter().map(|by_set| Errors::pooled(by_set)).collect();
    print_tables(&sets, &found, &pooled, printer);
    let folder = match (pictures, workspaces.first()) {
        (Some(folder), _) => folder.to_path_buf(),
        (None, first) => first.map(|w| w.work.join("bench")).unwrap_or_default(),
    };
    std::fs::create_dir_all(&folder).at("making a folder for the benchmark", &folder)?;
    let (csv, svg) = (folder.join("intensity.csv"), folder.join("intensity.svg"));
    std::fs::write(&csv, table(&sets, &found)).at("writing the errors", &csv)?;
    plot::write_svg(&svg, &panels(&sets, &pooled), 2)?;
    [csv, svg].iter().for_each(|path| printer.data(&path.display().to_string()));
    Ok(())
}

impl DataSet {
    /// The receiver vertices nearest to the object, with the capture's own response.
    fn read(workspace: &Workspace) -> Result<Self> {
        let statics = Static::read(workspace)?;
        let response: Response = json::read(&workspace.folder("response").join("response.json"))?;
        let name = super::capture_name(workspace)?;
        Ok(Self { name, response, receivers: receivers(&statics) })
    }

    /// Receivers of half the plate's range, of lights whose powers are spread as those of a room's patches: their
    /// logarithms are normal, of standard deviation 1.5. With the sRGB curve.
    fn synthetic() -> Self {
        let mut rng = SmallRng::seed_from_u64(7);
        let mut receiver = || {
            let mut powers: Vec<f32> = (0..4 * SOURCES)
                .map(|_| {
                    // Sum of 12 uniform numbers, less 6: nearly normal, of variance 1.
                    let normal: f32 = (0..12).map(|_| rng.random::<f32>()).sum::<f32>() - 6.0;
                    (1.5 * normal).exp()
                })
                .collect();
            powers.sort_by(|a, b| b.total_cmp(a));
            let radiance = [rng.random_range(0.3f32..0.7); 3];
            let sum: f32 = powers.iter().sum();
            let transfers = powers.iter().map(|p| radiance.map(|v| 0.95 * v * p / sum)).collect();
            Receiver { radiance, transfers }
        };
        let receivers = (0..VERTICES).map(|_| receiver()).collect();
        Self { name: "synthetic".into(), response: Response::srgb(), receivers }
    }

    /// T, in 8-bit code values.
    fn tone(&self, codes: Codes) -> impl Fn([f32; 3]) -> [f32; 3] {
        move |radiance| {
            let values = self.response.code_of(radiance).map(|c| c * TOP);
            if codes == Codes::Whole { values.map(f32::round) } else { values }
        }
    }

    fn errors(&self, variant: &Variant, trials: usize) -> Errors {
        (0..trials.div_ceil(CHUNK) as u64)
            .into_par_iter()
            .map(|chunk| {
                // The same draws for every variant.
                let mut rng = SmallRng::seed_from_u64(chunk);
                let mut errors = Errors::new();
                (0..CHUNK).for_each(|_| self.trial(variant, &mut rng, &mut errors));
                errors
            })
            .collect::<Vec<_>>()
            .iter()
            .fold(Errors::new(), |sum, part| sum.plus(part))
    }

    /// One draw of sources, sets, and an order in which sources become occluded.
    fn trial(&self, variant: &Variant, rng: &mut SmallRng, errors: &mut Errors) {
        let receiver = &self.receivers[rng.random_range(0..self.receivers.len())];
        let parts = receiver.draw(rng);
        let mut order: Vec<usize> = (0..parts.len()).collect();
        order.shuffle(rng);
        let sets = deal(parts.len(), variant.first_share, rng);
        let pairs = sets.into_iter().zip(parts.iter().copied());
        let taken: Vec<[f32; 3]> =
            intensity_transfers(receiver.radiance, pairs, self.tone(variant.codes)).collect();
        let exact = self.tone(Codes::Smooth);
        let mut code = self.tone(variant.codes)(receiver.radiance);
        let mut left = receiver.radiance.map(f64::from);
        errors.trials += 1.0;
        for occluded in 0..=parts.len() {
            if let Some(&j) = occluded.checked_sub(1).and_then(|k| order.get(k)) {
                for c in 0..3 {
                    let whole = variant.codes == Codes::RoundedTransfers;
                    code[c] -= if whole { taken[j][c].round() } else { taken[j][c] };
                    left[c] -= f64::from(parts[j][c]);
                }
            }
            let truth = exact(left.map(|v| v.max(0.0) as f32));
            for c in 0..3 {
                let error = f64::from(code[c].max(0.0) - truth[c]);
                let [sum, square] = &mut errors.sums[occluded][c];
                (*sum, *square) = (*sum + error, *square + error * error);
            }
        }
    }

    /// Green codes left after each pass when all of one draw's sources are occluded.
    fn falling(&self) -> Vec<(f64, f64)> {
        let mut rng = SmallRng::seed_from_u64(1);
        let receiver = &self.receivers[0];
        let parts = receiver.draw(&mut rng);
        let mut left = receiver.radiance.map(f64::from);
        let tone = self.tone(Codes::Smooth);
        let mut points = vec![(0.0, f64::from(tone(receiver.radiance)[1]))];
        for (k, part) in parts.iter().enumerate() {
            (0..3).for_each(|c| left[c] = (left[c] - f64::from(part[c])).max(0.0));
            points.push((k as f64 + 1.0, f64::from(tone(left.map(|v| v as f32))[1])));
        }
        points
    }
}

impl Receiver {
    /// Some sources at random, in their order, scaled so that they send together what all do: as clusters would.
    fn draw(&self, rng: &mut SmallRng) -> Vec<[f32; 3]> {
        let mut chosen = rand::seq::index::sample(rng, self.transfers.len(), SOURCES).into_vec();
        chosen.sort_unstable();
        let sum = |of: &mut dyn Iterator<Item = &[f32; 3]>| {
            of.fold([0.0f64; 3], |sum, t| std::array::from_fn(|c| sum[c] + f64::from(t[c])))
        };
        let all = sum(&mut self.transfers.iter());
        let drawn = sum(&mut chosen.iter().map(|&j| &self.transfers[j]));
        let scale: [f64; 3] = std::array::from_fn(|c| if drawn[c] > 0.0 { all[c] / drawn[c] } else { 0.0 });
        let scaled = |j: usize| std::array::from_fn(|c| (f64::from(self.transfers[j][c]) * scale[c]) as f32);
        chosen.into_iter().map(scaled).collect()
    }
}

/// The receiver vertices nearest to the object that the plate shows and enough sources reach.
fn receivers(statics: &Static) -> Vec<Receiver> {
    let transfers = &statics.transfers;
    let mesh = &transfers.receivers;
    let pixels = statics.receivers.pixels.pixels().iter().zip(statics.plate.pixels()).filter_map(|(r, p)| {
        let receiver = r.as_ref()?;
        let (vertices, weights) = mesh.locate(receiver.patch, receiver.barycentric)?;
        Some((vertices, weights, p.0))
    });
    let radiance = vertex_radiance(mesh.positions.len(), pixels);
    let bounds = Bounds::of(&statics.occluder());
    let distance = |v: usize| mesh.positions[v].distance(mesh.positions[v].clamp(bounds.min, bounds.max));
    let mut order: Vec<usize> = (0..radiance.len()).filter(|&v| luminance(radiance[v]) > 0.0).collect();
    order.sort_by(|&a, &b| distance(a).total_cmp(&distance(b)));
    let mut strongest: Vec<usize> = (0..transfers.sources.len()).collect();
    strongest.sort_by(|&a, &b| transfers.sources[b].mean.total_cmp(&transfers.sources[a].mean));
    let mut sent = vec![[0.0; 3]; transfers.sources.len()];
    let receiver = |v: usize| {
        transfers.expand(v as u32, &mut sent);
        // What the plate shows of a source: as much of its radiance as the source has of the irradiance.
        let all = transfers.irradiance.row(v);
        let part = |j: &usize| -> [f32; 3] {
            std::array::from_fn(|c| if all[c] > 0.0 { radiance[v][c] * sent[*j][c] / all[c] } else { 0.0 })
        };
        let parts: Vec<[f32; 3]> = strongest.iter().map(part).filter(|t| luminance(*t) > 0.0).collect();
        (parts.len() >= SOURCES).then_some(Receiver { radiance: radiance[v], transfers: parts })
    };
    order.into_iter().filter_map(receiver).take(VERTICES).collect()
}

impl Errors {
    fn new() -> Self {
        Self { trials: 0.0, sums: vec![[[0.0; 2]; 3]; SOURCES + 1] }
    }

    fn plus(mut self, other: &Self) -> Self {
        self.trials += other.trials;
        for (a, b) in self.sums.iter_mut().flatten().flatten().zip(other.sums.iter().flatten().flatten()) {
            *a += b;
        }
        self
    }

    fn pooled(sets: &[Self]) -> Self {
        sets.iter().fold(Self::new(), |sum, part| sum.plus(part))
    }

    /// Mean error and mean squared error.
    fn moments(&self, occluded: usize, channel: usize) -> [f64; 2] {
        self.sums[occluded][channel].map(|s| s / self.trials)
    }

    /// Mean squared error over all channels and some numbers of occluded sources.
    fn mean_square(&self, occluded: std::ops::RangeInclusive<usize>) -> f64 {
        let count = 3.0 * occluded.clone().count() as f64;
        occluded.flat_map(|p| (0..3).map(move |c| self.moments(p, c)[1])).sum::<f64>() / count
    }
}

fn print_tables(sets: &[DataSet], found: &[Vec<Errors>], pooled: &[Errors], printer: &Printer) {
    let names: Vec<&str> = sets.iter().map(|s| s.name.as_str()).collect();
    printer.data(&format!(
        "\nintensity transfers (gibson §7.1, Figure 3): mean error (+ too bright) and mean squared error, codes of 8 \
         bits, P of {SOURCES} sources occluded; {TRIALS} trials each of {}",
        names.join(", ")
    ));
    let head: String =
        VARIANTS[..PAPERS].iter().map(|v| format!("{:>9} mean       R       G       B", v.name)).collect();
    printer.data(&format!("{:>4}{head}", "P"));
    for occluded in (0..=SOURCES).step_by(5) {
        let cell = |e: &Errors| {
            let [r, g, b] = [0, 1, 2].map(|c| e.moments(occluded, c));
            let mean = (r[0] + g[0] + b[0]) / 3.0;
            format!("{mean:>+14.2}{:>8.2}{:>8.2}{:>8.2}", r[1], g[1], b[1])
        };
        printer.data(&format!("{occluded:>4}{}", pooled[..PAPERS].iter().map(cell).collect::<String>()));
    }
    printer.data(&format!(
        "\nroot mean squared error, codes, where {}–{} % are occluded (the paper: 30–50 % near objects), and over all P",
        100 * TYPICAL.start() / SOURCES,
        100 * TYPICAL.end() / SOURCES
    ));
    let head: String = names.iter().map(|n| format!("{n:>16}")).collect();
    printer.data(&format!("{:<26}{head}{:>16}", "sets", "all"));
    for (variant, (by_set, all)) in VARIANTS.iter().zip(found.iter().zip(pooled)) {
        let cell = |e: &Errors| {
            format!("{:>9.2}{:>7.2}", e.mean_square(TYPICAL).sqrt(), e.mean_square(0..=SOURCES).sqrt())
        };
        let cells: String = by_set.iter().chain([all]).map(cell).collect();
        printer.data(&format!("{:<26}{cells}", variant.name));
    }
    printer.data(
        "the paper's figure: the error is small for few occluded sources and where their share is that of a set (P = 25 for \
         50/50), and rises between; 50/50 is best where 30–50 % are occluded",
    );
}

fn table(sets: &[DataSet], found: &[Vec<Errors>]) -> String {
    let mut text = String::from("data_set,sets,occluded,channel,mean_error,mean_squared_error\n");
    for (variant, by_set) in VARIANTS.iter().zip(found) {
        for (set, errors) in sets.iter().zip(by_set) {
            for (p, c) in (0..=SOURCES).flat_map(|p| (0..3).map(move |c| (p, c))) {
                let [mean, square] = errors.moments(p, c);
                let (name, channel) = (variant.name.replace(", ", " "), ["red", "green", "blue"][c]);
                let _ = writeln!(text, "{},{name},{p},{channel},{mean:.5},{square:.5}", set.name);
            }
        }
    }
    text
}

fn panels(sets: &[DataSet], pooled: &[Errors]) -> Vec<Panel> {
    let largest = |e: &Errors| e.sums.iter().flatten().map(|s| s[1] / e.trials).fold(1.0, f64::max);
    // One range for all, so that they can be compared.
    let range = Some((0.1, 2.0 * pooled[..PAPERS].iter().map(largest).fold(1.0, f64::max)));
    let falling = sets.iter().zip(plot::DISTINCT).map(|(set, colour)| Line {
        label: set.name.clone(),
        colour,
        points: set.falling(),
    });
    let mut panels = vec![Panel {
        title: "Codes left after each pass".into(),
        x: Axis::linear("passes"),
        y: Axis::linear("green, 8-bit code values"),
        lines: falling.collect(),
    }];
    for (variant, errors) in VARIANTS[..PAPERS].iter().zip(pooled) {
        let lines = ["red", "green", "blue"].iter().zip(plot::CHANNELS).enumerate();
        panels.push(Panel {
            title: format!("Error with sets {}", variant.name),
            x: Axis::linear(&format!("occluded sources P of {SOURCES}")),
            y: Axis { range, ..Axis::log("mean squared error, code values²") },
            lines: lines
                .map(|(c, (label, colour))| Line {
                    label: (*label).into(),
                    colour,
                    points: (0..=SOURCES).map(|p| (p as f64, errors.moments(p, c)[1])).collect(),
                })
                .collect(),
        });
    }
    panels
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_vanish_where_a_set_is_occluded_whole_and_half_and_half_is_best_between() {
        let set = DataSet::synthetic();
        let [half, quarter, all] = [0, 1, 2].map(|v| set.errors(&VARIANTS[v], 1000));
        for errors in [&half, &quarter, &all] {
            assert!(errors.mean_square(0..=0) < 1e-9, "nothing is occluded");
            assert!(errors.mean_square(2..=2) < errors.mean_square(20..=20));
        }
        assert!(all.mean_square(SOURCES..=SOURCES) < 1e-3, "all are, as was assumed");
        assert!(half.mean_square(SOURCES..=SOURCES) > 100.0, "all are, against the assumption");
        let mean = |p: usize| half.moments(p, 1)[0];
        assert!(mean(25).abs() < 0.2 * mean(12).abs(), "on average exact at 25: {}", mean(25));
        let typical = [&half, &quarter, &all].map(|e| e.mean_square(TYPICAL));
        assert!(typical[0] < typical[1] && typical[1] < typical[2], "{typical:?}");
    }

    #[test]
    fn drawn_sources_send_what_all_do() {
        let set = DataSet::synthetic();
        let parts = set.receivers[0].draw(&mut SmallRng::seed_from_u64(3));
        let sum = |of: &[[f32; 3]]| of.iter().map(|t| f64::from(t[1])).sum::<f64>();
        assert_eq!(parts.len(), SOURCES);
        assert!((sum(&parts) / sum(&set.receivers[0].transfers) - 1.0).abs() < 1e-5);
    }
}
