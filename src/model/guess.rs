//! Where a fit starts: each primitive from its own marks, what it refers to being in place.

use super::Problem;
use super::feature::{Feature, feature};
use super::parameters;
use super::placed::Placed;
use super::sight::Sight;
use super::tree::{Node, Parameter, Tree, Values};
use crate::annotations::{Kind, Mark};
use crate::least_squares;
use nalgebra::{DMatrix, DVector, Point3};
use std::f64::consts::PI;

/// A primitive without a mark to say so is this large, m.
const UNTOLD_M: f64 = 1.0;

/// All values, and where they put the primitives. A primitive that would be behind a camera there is refused.
pub(super) fn first_guess(tree: &Tree) -> Result<Values, Problem> {
    let mut values = tree.values(&vec![0.0; tree.free.len()]);
    let mut placed: Vec<Placed> = Vec::new();
    for i in 0..tree.nodes.len() {
        tree.tie(i, &mut values);
        if let Some(found) = tree.nodes[i].found {
            free(&tree.nodes[i]).into_iter().for_each(|k| values[i][k] = found.start[k]);
        } else if tree.nodes[i].primitive.kind == Kind::Cylinder {
            cylinder(tree, i, &mut values, &placed)?;
        } else {
            angles(tree, i, &mut values, &placed)?;
        }
        let own = tree.place_one(i, &values, &placed)?;
        check_in_front(tree, i, &values, &own, &placed)?;
        placed.push(own);
    }
    Ok(values)
}

/// Condition number from which on what lies behind a camera is said to be loose: what it stands on is not yet exact.
const LOOSE: f64 = 100.0;

/// What lies behind a camera is there because its marks leave it loose, or because one of them is wrong.
fn check_in_front(
    tree: &Tree,
    i: usize,
    values: &Values,
    own: &Placed,
    placed: &[Placed],
) -> Result<(), Problem> {
    let node = &tree.nodes[i];
    for (mark, sight) in node.primitive.marks.iter().zip(&node.sights) {
        if feature(node.primitive, own, &values[i], &mark.corner).and_then(|f| sight.miss(&f)).is_some() {
            continue;
        }
        if node.primitive.kind != Kind::Cylinder {
            let free = free(node);
            let (matrix, _) = equations(tree, i, &mut values.clone(), &free, placed, None)?;
            let names = parameters::names(node.primitive);
            let called = |k: usize| format!("the {} of `{}`", names[free[k]], node.primitive.name);
            least_squares::determined(&matrix, LOOSE, &called)?;
        }
        let (corner, image) = (mark.corner.clone(), mark.image.clone());
        return Err(Problem::Behind { name: node.primitive.name.clone(), corner, image });
    }
    Ok(())
}

fn free(node: &Node) -> Vec<usize> {
    (0..node.parameters.len()).filter(|&k| node.parameters[k] == Parameter::Free).collect()
}

/// For a given turn or lean all corners are linear in the other parameters, and lying on a mark's ray is a linear equation; the
/// angle is searched.
fn angles(tree: &Tree, i: usize, values: &mut Values, placed: &[Placed]) -> Result<(), Problem> {
    let node = &tree.nodes[i];
    let mut free = free(node);
    let searched = [parameters::turn(node.primitive.kind), parameters::lean(node.primitive)];
    let angle = searched.into_iter().flatten().find(|k| free.contains(k));
    let tried: Vec<f64> = match angle {
        Some(k) if parameters::lean(node.primitive) == Some(k) => {
            (1..30).map(|n| f64::from(n) * PI / 60.0).collect()
        }
        Some(_) => (0..120).map(|n| f64::from(3 * n).to_radians()).collect(),
        None => vec![0.0],
    };
    free.retain(|&k| Some(k) != angle);
    let mut best: Option<(f64, Vec<f64>)> = None;
    for value in tried {
        if let Some(k) = angle {
            values[i][k] = value;
        }
        let cost = solve_linear(tree, i, values, &free, placed)?;
        if best.as_ref().is_none_or(|(least, _)| cost < *least) {
            best = Some((cost, values[i].clone()));
        }
    }
    if let Some((_, own)) = best {
        values[i] = own;
    }
    Ok(())
}

/// Where its marked corners are, m, and what sees them. Marks along edges wait for the fit.
fn corners<'a>(
    tree: &'a Tree,
    i: usize,
    values: &Values,
    placed: &[Placed],
) -> Result<Vec<(Point3<f64>, &'a Sight<'a>)>, Problem> {
    let node = &tree.nodes[i];
    let own = tree.place_one(i, values, placed)?;
    let marks = node.primitive.marks.iter().zip(&node.sights);
    let corner =
        |(m, sight): (&Mark, &'a Sight<'a>)| match feature(node.primitive, &own, &values[i], &m.corner) {
            Some(Feature::Point(point)) => Some((point, sight)),
            _ => None,
        };
    Ok(marks.filter_map(corner).collect())
}

/// Linear equations of the free values, for corners at some distances (m) from who sees them, 1 m unless known. Leaves these
/// values at 0.
fn equations(
    tree: &Tree,
    i: usize,
    values: &mut Values,
    free: &[usize],
    placed: &[Placed],
    distances: Option<&[f64]>,
) -> Result<(DMatrix<f64>, DVector<f64>), Problem> {
    free.iter().for_each(|&k| values[i][k] = 0.0);
    let zero = corners(tree, i, values, placed)?;
    let mut matrix = DMatrix::zeros(2 * zero.len(), free.len());
    let mut right = DVector::zeros(2 * zero.len());
    let mut shifts = Vec::new();
    for &k in free {
        values[i][k] = 1.0;
        let moved = corners(tree, i, values, placed)?;
        shifts.push(moved.iter().zip(&zero).map(|(a, b)| a.0 - b.0).collect::<Vec<_>>());
        values[i][k] = 0.0;
    }
    for (m, (zero, sight)) in zero.iter().enumerate() {
        let distance = distances.map_or(1.0, |all| all[m]);
        for (e, (row, value)) in sight.equations(distance).into_iter().enumerate() {
            right[2 * m + e] = value - row.dot(&zero.coords);
            shifts.iter().enumerate().for_each(|(k, s)| matrix[(2 * m + e, k)] = row.dot(&s[m]));
        }
    }
    Ok((matrix, right))
}

/// Sets the free values; returns their error, with a penalty for extents below zero and corners behind the camera.
fn solve_linear(
    tree: &Tree,
    i: usize,
    values: &mut Values,
    free: &[usize],
    placed: &[Placed],
) -> Result<f64, Problem> {
    let mut distances: Option<Vec<f64>> = None;
    // The second round knows how far the corners are, and weighs them.
    for _ in 0..3 {
        let (matrix, right) = equations(tree, i, values, free, placed, distances.as_deref())?;
        if !free.is_empty() && !right.is_empty() {
            let scale = matrix.norm().max(1e-9);
            let solution = matrix.svd(true, true).solve(&right, 1e-9 * scale);
            let solution = solution.map_err(|_| Problem::Fit(least_squares::Problem::Start))?;
            free.iter().zip(solution.iter()).for_each(|(&k, v)| values[i][k] = *v);
        }
        let away = |(corner, sight): &(Point3<f64>, &Sight)| (corner - sight.ray().origin).norm();
        distances = Some(corners(tree, i, values, placed)?.iter().map(away).collect());
    }
    let mut cost = 0.0;
    for k in parameters::extents(tree.nodes[i].primitive.kind) {
        if values[i][k] <= 0.0 {
            cost += 1e6;
            // Something to start from, for what the marks of this primitive alone do not tell.
            values[i][k] = if values[i][k] == 0.0 { UNTOLD_M } else { values[i][k] };
        }
    }
    for (corner, sight) in &corners(tree, i, values, placed)? {
        cost += sight.error(corner).map_or(1e6, |e| e.norm_squared().min(1e6));
    }
    Ok(cost)
}

/// Heights from which a cylinder is tried, m.
const HEIGHTS_M: [f64; 6] = [0.05, 0.12, 0.3, 0.7, 1.6, 3.5];

/// A cylinder's marks lie on curves: it starts from where their rays meet its rims' planes, for several heights, and is fitted.
fn cylinder(tree: &Tree, i: usize, values: &mut Values, placed: &[Placed]) -> Result<(), Problem> {
    let node = &tree.nodes[i];
    let free = free(node);
    let marks = || node.primitive.marks.iter().zip(&node.sights);
    let extents = parameters::extents(Kind::Cylinder);
    let given = |k: usize| (!free.contains(&k)).then_some(values[i][k]);
    let heights = given(extents.start + 1).map_or(HEIGHTS_M.to_vec(), |h| vec![h]);
    let mut best: Option<(f64, Vec<f64>)> = None;
    for height in heights {
        let mut tried = values.clone();
        free.iter().for_each(|&k| tried[i][k] = 0.0);
        tried[i][extents.start + 1] = height;
        tried[i][extents.start] = given(extents.start).unwrap_or(height);
        let Placed::Solid(own) = tree.place_one(i, &tried, placed)? else { continue };
        // In its own frame, where it stands in the middle.
        let hit = |(mark, sight): (&Mark, &Sight)| {
            let ray = sight.ray();
            let (from, to) =
                (own.frame.inverse() * ray.origin, own.frame.inverse() * ray.direction.into_inner());
            let level = match mark.corner.as_str() {
                "top" => height,
                "bottom" => 0.0,
                _ => height / 2.0,
            };
            let t = (level - from.y) / to.y;
            (t.is_finite() && t > 0.0).then(|| from + to * t)
        };
        let hits: Vec<Point3<f64>> = marks().filter_map(hit).collect();
        if hits.is_empty() {
            continue;
        }
        let middle = hits.iter().map(|p| p.coords).sum::<nalgebra::Vector3<f64>>() / hits.len() as f64;
        let reach =
            hits.iter().map(|p| (p.x - middle.x).hypot(p.z - middle.z)).sum::<f64>() / hits.len() as f64;
        if free.contains(&0) {
            (tried[i][0], tried[i][1]) = (middle.x, middle.z);
        }
        if free.contains(&extents.start) {
            tried[i][extents.start] = (2.0 * reach).max(0.02);
        }
        let residuals = |x: &DVector<f64>| {
            let mut all = tried.clone();
            free.iter().zip(x.iter()).for_each(|(&k, v)| all[i][k] = *v);
            let own = tree.place_one(i, &all, placed).ok()?;
            let mut rows = Vec::new();
            tree.misses(i, &all, &own)?.iter().for_each(|m| m.push(&mut rows));
            Some(DVector::from_vec(rows))
        };
        let start: Vec<f64> = free.iter().map(|&k| tried[i][k]).collect();
        let Some((x, cost)) = least_squares::descend(&residuals, DVector::from_vec(start), 60) else {
            continue;
        };
        let sound = free.iter().zip(x.iter()).all(|(k, v)| !extents.contains(k) || *v > 0.0);
        if sound && best.as_ref().is_none_or(|(least, _)| cost < *least) {
            free.iter().zip(x.iter()).for_each(|(&k, v)| tried[i][k] = *v);
            best = Some((cost, tried[i].clone()));
        }
    }
    match best {
        Some((_, own)) => values[i] = own,
        None => {
            for k in extents.filter(|k| free.contains(k)) {
                values[i][k] = UNTOLD_M;
            }
        }
    }
    Ok(())
}
