//! Line plots as SVG.

use crate::error::{Error, Result};
use plotters::coord::ranged1d::{AsRangedCoord, ValueFormatter};
use plotters::prelude::*;
use std::path::Path;

/// Size of a panel, px.
const PANEL: (u32, u32) = (520, 380);
/// Lines of at most so many points get a mark at each.
const MARKED: usize = 20;

/// Red, green and blue that read on white; for lines that stand for channels.
pub(super) const CHANNELS: [RGBColor; 3] =
    [RGBColor(200, 40, 40), RGBColor(40, 140, 60), RGBColor(50, 80, 200)];
/// Colours that those with colour-blindness can tell apart (Okabe and Ito 2008); for all other lines.
pub(super) const DISTINCT: [RGBColor; 7] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
    RGBColor(60, 60, 60),
];

/// How values lie along an axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Scale {
    /// From 0.
    Linear,
    /// Values at and below 0 are left out.
    Log,
}

/// An axis.
#[derive(Debug, Clone)]
pub(super) struct Axis {
    /// What it shows, with its unit.
    pub label: String,
    pub scale: Scale,
    /// What it spans; without it, what the lines do.
    pub range: Option<(f64, f64)>,
}

/// A line and its entry in the legend.
#[derive(Debug, Clone)]
pub(super) struct Line {
    pub label: String,
    pub colour: RGBColor,
    pub points: Vec<(f64, f64)>,
}

/// One plot of a figure.
#[derive(Debug, Clone)]
pub(super) struct Panel {
    pub title: String,
    pub x: Axis,
    pub y: Axis,
    pub lines: Vec<Line>,
}

impl Axis {
    pub fn linear(label: &str) -> Self {
        Self { label: label.into(), scale: Scale::Linear, range: None }
    }

    pub fn log(label: &str) -> Self {
        Self { scale: Scale::Log, ..Self::linear(label) }
    }

    /// The range drawn for some values, with a little room above.
    fn span(&self, values: impl Iterator<Item = f64>) -> Span {
        let usable = values.filter(|v| self.shows(*v));
        let (low, high) = usable.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)));
        match (self.range, self.scale) {
            (Some((low, high)), _) => low..high,
            (None, Scale::Linear) => low.min(0.0)..if high > 0.0 { high * 1.05 } else { 1.0 },
            (None, Scale::Log) if low > high => 0.1..1.0,
            (None, Scale::Log) => low / 1.2..high * 1.2,
        }
    }

    fn shows(&self, v: f64) -> bool {
        let inside = self.range.is_none_or(|(low, high)| (low..=high).contains(&v));
        inside && v.is_finite() && (self.scale == Scale::Linear || v > 0.0)
    }

    /// Where on the axis a value lies, 0..1.
    fn place(&self, v: f64, span: &Span) -> f64 {
        match self.scale {
            Scale::Linear => (v - span.start) / (span.end - span.start),
            Scale::Log => (v / span.start).ln() / (span.end / span.start).ln(),
        }
    }
}

impl Panel {
    fn points(&self) -> impl Iterator<Item = &(f64, f64)> {
        self.lines.iter().flat_map(|l| &l.points).filter(|(x, y)| self.x.shows(*x) && self.y.shows(*y))
    }

    /// Where a legend hides least.
    fn emptiest_corner(&self, x: &Span, y: &Span) -> SeriesLabelPosition {
        let hidden = |right: bool, upper: bool| {
            let inside = |v: f64, far: bool| if far { v > 0.7 } else { v < 0.3 };
            let covers = |(a, b): &&(f64, f64)| {
                inside(self.x.place(*a, x), right) && inside(self.y.place(*b, y), upper)
            };
            self.points().filter(covers).count()
        };
        use SeriesLabelPosition::{LowerLeft, LowerRight, UpperLeft, UpperRight};
        let corners = [
            (true, true, UpperRight),
            (false, true, UpperLeft),
            (true, false, LowerRight),
            (false, false, LowerLeft),
        ];
        let best = corners.into_iter().min_by_key(|(right, upper, _)| hidden(*right, *upper));
        best.map_or(UpperRight, |(.., corner)| corner)
    }
}

/// Writes a figure of panels, so many side by side.
pub(super) fn write_svg(path: &Path, panels: &[Panel], columns: usize) -> Result<()> {
    draw(path, panels, columns.clamp(1, panels.len().max(1))).map_err(|e| {
        Error::file("writing a plot", path, e, "check the disk and the permissions of the folder")
    })
}

type Span = std::ops::Range<f64>;
type Drawn = std::result::Result<(), Box<dyn std::error::Error>>;

fn draw(path: &Path, panels: &[Panel], columns: usize) -> Drawn {
    let rows = panels.len().div_ceil(columns).max(1);
    let size = (PANEL.0 * columns as u32, PANEL.1 * rows as u32);
    let figure = SVGBackend::new(path, size).into_drawing_area();
    figure.fill(&WHITE)?;
    for (area, panel) in figure.split_evenly((rows, columns)).iter().zip(panels) {
        let values =
            |of: fn(&(f64, f64)) -> f64| panel.lines.iter().flat_map(move |l| l.points.iter().map(of));
        let (x, y) = (panel.x.span(values(|p| p.0)), panel.y.span(values(|p| p.1)));
        let legend = panel.emptiest_corner(&x, &y);
        match (panel.x.scale, panel.y.scale) {
            (Scale::Linear, Scale::Linear) => draw_panel(area, panel, legend, x, y)?,
            (Scale::Log, Scale::Linear) => draw_panel(area, panel, legend, decades(x), y)?,
            (Scale::Linear, Scale::Log) => draw_panel(area, panel, legend, x, decades(y))?,
            (Scale::Log, Scale::Log) => draw_panel(area, panel, legend, decades(x), decades(y))?,
        }
    }
    figure.present()?;
    Ok(())
}

/// A logarithmic axis with marks at 1, 2 and 5 of each decade, or at powers of ten where there are many.
fn decades(span: Span) -> impl AsRangedCoord<Value = f64, CoordDescType: ValueFormatter<f64>> {
    let marks = marks(&span);
    span.log_scale().with_key_points(marks)
}

fn marks(span: &Span) -> Vec<f64> {
    let (first, last) = (span.start.log10().floor() as i32, span.end.log10().ceil() as i32);
    let each: &[f64] = if last - first > 3 { &[1.0] } else { &[1.0, 2.0, 5.0] };
    let all = (first..=last).flat_map(|decade| each.iter().map(move |m| m * 10f64.powi(decade)));
    all.filter(|v| (span.start..=span.end).contains(v)).collect()
}

fn draw_panel<X, Y>(
    area: &DrawingArea<SVGBackend, plotters::coord::Shift>,
    panel: &Panel,
    legend: SeriesLabelPosition,
    x: X,
    y: Y,
) -> Drawn
where
    X: AsRangedCoord<Value = f64>,
    Y: AsRangedCoord<Value = f64>,
    X::CoordDescType: ValueFormatter<f64>,
    Y::CoordDescType: ValueFormatter<f64>,
{
    let mut chart = ChartBuilder::on(area)
        .caption(&panel.title, ("sans-serif", 17))
        .margin(12)
        .x_label_area_size(42)
        .y_label_area_size(58)
        .build_cartesian_2d(x, y)?;
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .x_desc(&panel.x.label)
        .y_desc(&panel.y.label)
        .x_label_formatter(&|v| short(*v))
        .y_label_formatter(&|v| short(*v))
        .label_style(("sans-serif", 13))
        .axis_desc_style(("sans-serif", 14))
        .draw()?;
    for line in &panel.lines {
        let shown = line.points.iter().copied().filter(|(x, y)| panel.x.shows(*x) && panel.y.shows(*y));
        let (colour, style) = (line.colour, line.colour.stroke_width(2));
        chart
            .draw_series(LineSeries::new(shown.clone(), style))?
            .label(&line.label)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], style));
        if line.points.len() <= MARKED {
            chart.draw_series(shown.map(|p| Circle::new(p, 3, colour.filled())))?;
        }
    }
    chart
        .configure_series_labels()
        .position(legend)
        .background_style(WHITE.mix(0.85))
        .border_style(BLACK.mix(0.3))
        .label_font(("sans-serif", 13))
        .draw()?;
    Ok(())
}

/// A number of an axis, without zeros at its end.
fn short(v: f64) -> String {
    if v != 0.0 && !(1e-4..1e6).contains(&v.abs()) {
        return format!("{v:.0e}");
    }
    let text = format!("{v:.4}");
    text.trim_end_matches('0').trim_end_matches('.').to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_figure_names_what_it_shows() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.svg");
        let line =
            Line { label: "office".into(), colour: DISTINCT[0], points: vec![(10.0, 0.3), (200.0, 0.01)] };
        let panel = |x: Axis, y: Axis| Panel { title: "Error".into(), x, y, lines: vec![line.clone()] };
        let panels = [
            panel(Axis::log("passes"), Axis::log("error")),
            panel(Axis::linear("passes"), Axis::linear("error")),
        ];
        write_svg(&path, &panels, 2).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        for word in ["<svg", "Error", "office", "passes", "error"] {
            assert!(text.contains(word), "no {word}");
        }
        assert!(text.matches("<polyline").count() >= 2, "a line in each");
    }

    #[test]
    fn every_logarithmic_axis_has_marks_and_not_too_many() {
        for (span, expected) in [
            (0.012..0.07, vec![0.02, 0.05]),
            (80.0..6500.0, vec![100.0, 200.0, 500.0, 1000.0, 2000.0, 5000.0]),
            (0.5..2e4, vec![1.0, 10.0, 100.0, 1000.0, 1e4]),
        ] {
            let found = marks(&span);
            assert_eq!(found.len(), expected.len(), "{found:?}");
            assert!(found.iter().zip(&expected).all(|(a, b)| (a / b - 1.0).abs() < 1e-9), "{found:?}");
        }
    }

    #[test]
    fn a_legend_stands_where_no_line_is() {
        let rising = Line {
            label: String::new(),
            colour: DISTINCT[0],
            points: (0..50).map(|i| (f64::from(i), f64::from(i))).collect(),
        };
        let panel =
            Panel { title: String::new(), x: Axis::linear(""), y: Axis::linear(""), lines: vec![rising] };
        let corner = panel.emptiest_corner(&(0.0..50.0), &(0.0..50.0));
        assert!(matches!(corner, SeriesLabelPosition::UpperLeft), "{corner:?}");
    }

    #[test]
    fn empty_lines_make_an_empty_plot() {
        let dir = tempfile::tempdir().unwrap();
        let line = Line { label: "none".into(), colour: DISTINCT[0], points: Vec::new() };
        let panel =
            Panel { title: "Nothing".into(), x: Axis::log("x"), y: Axis::linear("y"), lines: vec![line] };
        write_svg(&dir.path().join("a.svg"), &[panel], 1).unwrap();
    }
}
