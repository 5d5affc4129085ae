//! What the picture says of the room's faces, apart from their edges: which way the line segments on them run, and their colours.

use super::evidence::Evidence;
use super::layout::{Layout, SIDES, UP};
use super::view::View;
use nalgebra::{Point2, Vector3};

/// Segments this near to one line belong to it, px.
const ON_LINE_PX: f64 = 1.5;
/// Width of the picture of colours, px.
const COLOURS_PX: usize = 160;
/// Classes of brightness and of each opposed colour, equally full.
const CLASSES: [usize; 3] = [6, 5, 5];
/// Of a line that crosses from one face to another at least this much lies on both, in pieces.
const CROSSING: f64 = 1.0;

/// A part of a segment.
struct Sample {
    ray: Vector3<f64>,
    line: usize,
    /// Its length, in pieces.
    length: f64,
}

/// Segments by line, and classes of colour.
pub struct Contents {
    samples: Vec<Sample>,
    /// The axis along which each line runs.
    axes: Vec<usize>,
    /// Rays and their class of colour.
    colours: Vec<(Vector3<f64>, usize)>,
}

/// Lengths that contradict a layout, in pieces.
#[derive(Debug, Clone, Copy)]
pub struct Against {
    /// Of lines that run on from a face into another out of which they would stick.
    pub crossing: f64,
    /// Of lines that stick out of a face: things in the room have such edges, too.
    pub sticking_out: f64,
}

impl Contents {
    pub fn new(view: &View, evidence: &Evidence) -> Self {
        let (mut samples, mut axes) = (Vec::new(), Vec::new());
        for (axis, segments) in view.segments.iter().enumerate() {
            let vanishing = view.axis(axis);
            let lines = lines(segments, |at| {
                let ([f, g], [cx, cy]) = (view.lens.focal_px, view.lens.principal_point_px);
                let towards = nalgebra::Vector2::new(f * vanishing.x, g * vanishing.y)
                    + (Point2::new(cx, cy) - at) * vanishing.z;
                towards.try_normalize(1e-9)
            });
            let first = axes.len();
            axes.resize(first + lines.iter().map(|l| l + 1).max().unwrap_or(0), axis);
            for ([p, q], line) in segments.iter().zip(lines) {
                let length = (q - p).norm();
                let count = (length / (0.4 * evidence.piece_px)).ceil().max(1.0);
                samples.extend((0..count as usize).map(|k| Sample {
                    ray: view.ray(&(p + (q - p) * ((k as f64 + 0.5) / count))),
                    line: first + line,
                    length: length / count / evidence.piece_px,
                }));
            }
        }
        Self { samples, axes, colours: colours(view) }
    }

    /// What of the segments contradicts a layout.
    pub fn against(&self, layout: &Layout) -> Against {
        let mut on_lines = vec![[0.0; 2]; self.axes.len()];
        for sample in &self.samples {
            if let Some((side, _)) = layout.face(&sample.ray) {
                let sticks_out = side.normal() == self.axes[sample.line];
                on_lines[sample.line][usize::from(sticks_out)] += sample.length;
            }
        }
        let mut against = Against { crossing: 0.0, sticking_out: 0.0 };
        for ([within, out], axis) in on_lines.into_iter().zip(&self.axes) {
            // What stands on the floor reaches up before the wall.
            let crosses = *axis != UP && within.min(out) >= CROSSING;
            *(if crosses { &mut against.crossing } else { &mut against.sticking_out }) += out;
        }
        against
    }

    /// How much a pixel's colour tells of its face: their mutual information, nats.
    pub fn told_by_colour(&self, layout: &Layout) -> f64 {
        const ALL: usize = CLASSES[0] * CLASSES[1] * CLASSES[2];
        let mut counts = vec![[0.0; ALL]; SIDES.len() + 1];
        for (ray, class) in &self.colours {
            let side = layout.face(ray).and_then(|(side, _)| SIDES.iter().position(|s| *s == side));
            counts[side.unwrap_or(SIDES.len())][*class] += 1.0;
        }
        let total = self.colours.len() as f64;
        let of_class: Vec<f64> = (0..ALL).map(|c| counts.iter().map(|face| face[c]).sum()).collect();
        let told = counts.iter().map(|face| {
            let of_face: f64 = face.iter().sum();
            let cells = face.iter().zip(&of_class).filter(|(n, _)| **n > 0.0);
            cells.map(|(n, class)| n / total * (n * total / (of_face * class)).ln()).sum::<f64>()
        });
        told.sum()
    }
}

/// Numbers of the lines that segments lie on, from 0; `towards`: the direction at a pixel in which all of them run.
fn lines(
    segments: &[[Point2<f64>; 2]],
    towards: impl Fn(&Point2<f64>) -> Option<nalgebra::Vector2<f64>>,
) -> Vec<usize> {
    let middles: Vec<Point2<f64>> = segments.iter().map(|[p, q]| nalgebra::center(p, q)).collect();
    let mut line: Vec<usize> = (0..segments.len()).collect();
    for (i, middle) in middles.iter().enumerate() {
        let Some(along) = towards(middle) else { continue };
        for (j, other) in middles.iter().enumerate() {
            if line[i] != line[j] && (other - middle).perp(&along).abs() < ON_LINE_PX {
                let (kept, lost) = (line[i].min(line[j]), line[i].max(line[j]));
                line.iter_mut().filter(|l| **l == lost).for_each(|l| *l = kept);
            }
        }
    }
    line
}

/// Rays of a small picture with their classes of colour.
fn colours(view: &View) -> Vec<(Vector3<f64>, usize)> {
    let picture = &view.picture;
    let by = picture.width().div_ceil(COLOURS_PX).max(1);
    let (width, height) = (picture.width() / by, picture.height() / by);
    let mean = |k: usize, c: usize| {
        let (x, y) = (k % width * by, k / width * by);
        let pixels = (0..by * by).map(|d| picture.at(x + d % by, y + d / by)[c]);
        pixels.sum::<f32>() / (by * by) as f32
    };
    let mut classes = vec![0; width * height];
    for (c, count) in CLASSES.into_iter().enumerate() {
        let values: Vec<f32> = (0..classes.len()).map(|k| mean(k, c)).collect();
        let mut sorted = values.clone();
        sorted.sort_by(f32::total_cmp);
        let limits: Vec<f32> = (1..count).map(|k| sorted[k * sorted.len() / count]).collect();
        for (class, value) in classes.iter_mut().zip(values) {
            *class = *class * count + limits.partition_point(|limit| *limit < value);
        }
    }
    let ray = |k: usize| {
        let [x, y] = [k % width, k / width].map(|v| (v as f64 + 0.5) * by as f64);
        view.ray(&crate::calibrate::undistorted(&view.lens, [x, y]))
    };
    (0..classes.len()).map(|k| (ray(k), classes[k])).collect()
}
