//! Exposures to radiance: curve and radiance against the truth of rendered captures or a published map, residuals on
//! exposures that did not enter, beside OpenCV and pfstools on the same input.

mod cost;
mod errors;
mod folder;
mod peers;
mod stability;
mod subject;

use self::errors::{curve_stops, log_ratio_stops, quantiles, relative};
use self::peers::{Made, PEERS};
use self::subject::Subject;
use crate::config;
use crate::error::{Context as _, Result};
use crate::exposure::Frame;
use crate::image::{Image, RadianceImage};
use crate::merge;
use crate::printer::Printer;
use crate::response::{self, Response};
use std::path::PathBuf;
use std::time::Instant;

pub(super) use cost::merge_cost;

/// Prints the table of every capture and folder of exposures named.
pub(super) fn print(paths: &[PathBuf], printer: &Printer) -> Result<()> {
    subjects(paths, printer)?.iter().try_for_each(|subject| one(subject, printer))
}

/// Prints time and memory on large frames, made of the most exposures of one view: the more, the fewer are repeated.
pub(super) fn print_cost(paths: &[PathBuf], printer: &Printer) -> Result<()> {
    let most = subjects(paths, printer)?.into_iter().max_by_key(|subject| subject.images.len());
    most.map_or(Ok(()), |subject| cost::print(&subject, printer))
}

/// Prints how the curve of each varies with what it is fitted to.
pub(super) fn print_stability(paths: &[PathBuf], printer: &Printer) -> Result<()> {
    subjects(paths, printer)?.iter().for_each(|subject| stability::print(subject, printer));
    Ok(())
}

fn subjects(paths: &[PathBuf], printer: &Printer) -> Result<Vec<Subject>> {
    Ok(paths
        .iter()
        .map(|p| Subject::under(p, printer))
        .collect::<Result<Vec<_>>>()?
        .into_iter()
        .flatten()
        .collect())
}

/// What a program made, with the figures that it is judged by.
struct Row<'a> {
    name: String,
    curves: Option<&'a [Vec<f64>; 3]>,
    radiance: &'a RadianceImage,
    variance: Option<&'a Image<[f32; 3]>>,
    residual: Option<[f64; 3]>,
    seconds: f64,
}

fn one(subject: &Subject, printer: &Printer) -> Result<()> {
    let (width, height) = subject.images[0].size();
    printer.data(&format!("\n{}: {} exposures of {width}×{height} px", subject.name, subject.images.len()));
    subject.remarks.iter().for_each(|r| printer.data(r));
    printer.data(&format!(
        "{:<20}{:>24}{:>16}{:>8}{:>24}{:>24}{:>8}",
        "", "curve, stops (R G B)", "radiance, %", "in 1σ", "published, stops", "residual, stops", "s"
    ));
    let started = Instant::now();
    let settings = config::Response::default();
    let response = response::fit(&subject.frames(), &settings).doing("fitting the response")?;
    let frames: Vec<Frame> = (subject.images.iter().zip(&response.exposures))
        .map(|(codes, e)| Frame { codes, exposure: e.used })
        .collect();
    let merged = merge::merge(&frames, &response, 1.0, &config::Merge::default()).doing("merging")?;
    let seconds = started.elapsed().as_secs_f64();
    let curves = response.curves.each_ref().map(|c| c.exposure.clone());
    let quality = response.quality.as_ref();
    let valid = merged.clipped.map(|c| !c);
    row(
        subject,
        &Row {
            name: "insitu".into(),
            curves: Some(&curves),
            radiance: &merged.radiance,
            variance: Some(&merged.variance),
            residual: quality.map(|q| q.held_out_stops),
            seconds,
        },
        &valid,
        printer,
    );
    for peer in PEERS {
        match peer.make(subject)? {
            Ok(Made { curves, radiance, seconds }) => row(
                subject,
                &Row {
                    name: peer.name(),
                    curves: curves.as_ref(),
                    radiance: &radiance,
                    variance: None,
                    residual: curves
                        .as_ref()
                        .and_then(|c| response::residual_stops(&subject.frames(), c, &settings).ok()),
                    seconds,
                },
                &valid,
                printer,
            ),
            Err(why) => printer.data(&format!("{:<20}  {why}", peer.name())),
        }
    }
    told(subject, &response, printer);
    Ok(())
}

/// The method, and exposures that the pixels contradict.
fn told(subject: &Subject, response: &Response, printer: &Printer) {
    let method = response.method.map_or("none".into(), |m| format!("{m:?}"));
    let found = response.exposures.iter().map(|e| {
        let sigma = e.sigma_stops.map_or("?".into(), |s| format!("{s:.2}"));
        format!("{:+.2}±{sigma}{}", e.departure_stops(), if e.is_corrected() { "!" } else { "" })
    });
    printer.data(&format!(
        "method {method}; exposures found against stated, stops: {}",
        found.collect::<Vec<_>>().join(" ")
    ));
    for (file, e) in subject.files.iter().zip(&response.exposures).filter(|(_, e)| e.is_doubtful()) {
        printer.data(&format!("  {}", e.told(&file.file_name().unwrap_or_default().to_string_lossy())));
    }
}

/// `valid`: where insitu does not say that the picture is clipped in every exposure.
fn row(subject: &Subject, row: &Row, valid: &Image<bool>, printer: &Printer) {
    let three = |v: Option<[f64; 3]>| v.map_or("-".into(), |v| v.map(|s| format!("{s:.3}")).join(" "));
    let truth = subject.truth.as_ref();
    let curve = truth.zip(row.curves).map(|(t, c)| std::array::from_fn(|k| curve_stops(&c[k], &t.curves[k])));
    let radiance = truth.map(|t| {
        let counts = t.well_exposed(&subject.exposures);
        let (errors, sigmas) = relative(row.radiance, row.variance, &t.radiance, &counts);
        let [median, high] = quantiles(errors);
        let inside = sigmas.iter().filter(|s| **s <= 1.0).count() as f64 / sigmas.len() as f64;
        (
            format!("{:.2} {:.2}", 100.0 * median, 100.0 * high),
            row.variance.map(|_| format!("{:.0} %", 100.0 * inside)),
        )
    });
    let (radiance, inside) = radiance.unwrap_or(("-".into(), None));
    let published = subject.published.as_ref().map(|p| log_ratio_stops(row.radiance, p, valid));
    printer.data(&format!(
        "{:<20}{:>24}{radiance:>16}{:>8}{:>24}{:>24}{:>8.2}",
        row.name,
        three(curve),
        inside.unwrap_or("-".into()),
        three(published),
        three(row.residual),
        row.seconds
    ));
}
