//! Polygons that may have dents and holes: filled with triangles, cut into convex pieces.

use nalgebra::Point2;
use spade::{ConstrainedDelaunayTriangulation, Triangulation};

/// Triangles (indices of `points`) of what lies inside closed outlines, an odd number of `edges` away from the outside: their
/// constrained Delaunay triangulation. `None` where edges cross or points coincide.
pub fn fill(points: &[Point2<f64>], edges: &[[usize; 2]]) -> Option<Vec<[usize; 3]>> {
    let mut crossing = false;
    let sites = points.iter().map(|p| spade::Point2::new(p.x, p.y)).collect();
    let mesh = ConstrainedDelaunayTriangulation::<spade::Point2<f64>>::try_bulk_load_cdt(
        sites,
        edges.to_vec(),
        |_| crossing = true,
    )
    .ok()?;
    if crossing || mesh.num_vertices() != points.len() {
        return None;
    }
    let inside = |triangle: &[usize; 3]| {
        let middle = triangle.iter().map(|&k| points[k].coords).sum::<nalgebra::Vector2<f64>>() / 3.0;
        let crossed = |e: &&[usize; 2]| passes_above(middle.into(), e.map(|k| points[k]));
        edges.iter().filter(crossed).count() % 2 == 1
    };
    let all = mesh.inner_faces().map(|f| f.vertices().map(|v| v.index()));
    Some(all.filter(inside).collect())
}

/// Whether a ray from a point along +x meets a segment.
fn passes_above(p: Point2<f64>, [a, b]: [Point2<f64>; 2]) -> bool {
    (a.y > p.y) != (b.y > p.y) && p.x < a.x + (b.x - a.x) * (p.y - a.y) / (b.y - a.y)
}

/// A polygon as convex ones, counter-clockwise, each given by indices of `points`. `outlines` are its border and its holes, each
/// around in either direction. `None` where an outline has no area, or outlines cross or touch.
pub fn convex_pieces(points: &[Point2<f64>], outlines: &[Vec<usize>]) -> Option<Vec<Vec<usize>>> {
    if outlines.iter().any(|o| o.len() < 3 || o.iter().any(|&k| k >= points.len())) {
        return None;
    }
    let next = |o: &Vec<usize>, i: usize| [o[i], o[(i + 1) % o.len()]];
    let edges: Vec<[usize; 2]> =
        outlines.iter().flat_map(|o| (0..o.len()).map(move |i| next(o, i))).collect();
    // Only the corners that are used: others would be cut in.
    let used: Vec<usize> = outlines.concat();
    let place = |k: usize| used.iter().position(|&u| u == k);
    let local: Vec<[usize; 2]> =
        edges.iter().map(|e| Some([place(e[0])?, place(e[1])?])).collect::<Option<_>>()?;
    let sites: Vec<Point2<f64>> = used.iter().map(|&k| points[k]).collect();
    let triangles = fill(&sites, &local)?;
    let area = |piece: &[usize]| signed_area(&piece.iter().map(|&k| points[k]).collect::<Vec<_>>());
    let of = |o: &Vec<usize>| area(o).abs();
    let expected = of(&outlines[0]) - outlines[1..].iter().map(of).sum::<f64>();
    let mut pieces: Vec<Vec<usize>> = triangles.into_iter().map(|t| t.map(|k| used[k]).to_vec()).collect();
    let found: f64 = pieces.iter().map(|p| area(p)).sum();
    // A hole that is not inside the border fills where it should not.
    if expected <= 0.0 || (found / expected - 1.0).abs() > 1e-6 {
        return None;
    }
    // Hertel and Mehlhorn 1983: diagonals that no dent needs go.
    while let Some((i, j, joined)) = joinable(points, &pieces) {
        pieces[i] = joined;
        pieces.remove(j);
    }
    Some(pieces)
}

/// Two convex pieces that are one without the edge between them.
fn joinable(points: &[Point2<f64>], pieces: &[Vec<usize>]) -> Option<(usize, usize, Vec<usize>)> {
    let pairs = (0..pieces.len()).flat_map(|j| (0..j).map(move |i| (i, j)));
    pairs
        .filter_map(|(i, j)| Some((i, j, joined(&pieces[i], &pieces[j])?)))
        .find(|(_, _, p)| is_convex(points, p))
}

/// Two polygons without the edge that they share.
fn joined(a: &[usize], b: &[usize]) -> Option<Vec<usize>> {
    let (n, m) = (a.len(), b.len());
    let shared = |i: usize, j: usize| a[i] == b[(j + 1) % m] && a[(i + 1) % n] == b[j];
    let (i, j) = (0..n).flat_map(|i| (0..m).map(move |j| (i, j))).find(|&(i, j)| shared(i, j))?;
    let first = (1..n + 1).map(|k| a[(i + k) % n]);
    Some(first.chain((2..m).map(|k| b[(j + k) % m])).collect())
}

fn is_convex(points: &[Point2<f64>], polygon: &[usize]) -> bool {
    let n = polygon.len();
    (0..n).all(|i| {
        let [a, b, c] = [i, i + 1, i + 2].map(|k| points[polygon[k % n]]);
        let (first, second) = (b - a, c - b);
        first.perp(&second) > 1e-9 * first.norm() * second.norm()
    })
}

/// Area of a polygon, below 0 where its corners go around clockwise.
pub fn signed_area(corners: &[Point2<f64>]) -> f64 {
    let n = corners.len();
    (0..n).map(|i| corners[i].coords.perp(&corners[(i + 1) % n].coords)).sum::<f64>() / 2.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn points(all: &[[f64; 2]]) -> Vec<Point2<f64>> {
        all.iter().map(|p| Point2::from(*p)).collect()
    }

    fn area_of(points: &[Point2<f64>], pieces: &[Vec<usize>]) -> f64 {
        let corners = |p: &Vec<usize>| p.iter().map(|&k| points[k]).collect::<Vec<_>>();
        pieces.iter().map(|p| signed_area(&corners(p))).sum()
    }

    #[test]
    fn a_convex_one_stays_in_one_piece_and_a_dented_one_becomes_two() {
        let square = points(&[[0.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.0, 0.0]]);
        let pieces = convex_pieces(&square, &[vec![0, 1, 2, 3]]).unwrap();
        assert_eq!(pieces.len(), 1);
        assert!((area_of(&square, &pieces) - 1.0).abs() < 1e-12, "counter-clockwise");
        let dent = points(&[[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [1.0, 1.0], [1.0, 2.0], [0.0, 2.0]]);
        assert_eq!(convex_pieces(&dent, &[vec![0, 1, 2, 3, 4, 5]]).unwrap().len(), 2);
    }

    #[test]
    fn holes_are_left_out() {
        let frame = points(&[
            [0.0, 0.0],
            [4.0, 0.0],
            [4.0, 3.0],
            [0.0, 3.0],
            [1.0, 1.0],
            [2.0, 1.0],
            [2.0, 2.0],
            [1.0, 2.0],
        ]);
        let pieces = convex_pieces(&frame, &[vec![0, 1, 2, 3], vec![4, 5, 6, 7]]).unwrap();
        assert!((area_of(&frame, &pieces) - 11.0).abs() < 1e-9);
        assert!(pieces.len() <= 5, "{pieces:?}");
        assert!(convex_pieces(&frame, &[vec![4, 5, 6, 7], vec![0, 1, 2, 3]]).is_none(), "a hole outside");
    }

    #[test]
    fn crossed_outlines_are_none() {
        let bow = points(&[[0.0, 0.0], [1.0, 1.0], [1.0, 0.0], [0.0, 1.0]]);
        assert_eq!(convex_pieces(&bow, &[vec![0, 1, 2, 3]]), None);
        assert_eq!(convex_pieces(&bow, &[vec![0, 1]]), None);
        let line = points(&[[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]]);
        assert_eq!(convex_pieces(&line, &[vec![0, 1, 2]]), None);
    }

    proptest! {
        #[test]
        fn pieces_are_convex_and_cover_the_polygon(radii in prop::collection::vec(0.2..1.0f64, 3..14)) {
            // Star-shaped about the origin: dents, but no crossings.
            let n = radii.len();
            let corner = |(k, r): (usize, &f64)| {
                let a = std::f64::consts::TAU * k as f64 / n as f64;
                Point2::new(r * a.cos(), r * a.sin())
            };
            let points: Vec<Point2<f64>> = radii.iter().enumerate().map(corner).collect();
            let pieces = convex_pieces(&points, &[(0..n).collect()]).unwrap();
            prop_assert!((area_of(&points, &pieces) / signed_area(&points) - 1.0).abs() < 1e-9);
            let turns = |p: &Vec<usize>| (0..p.len()).all(|i| {
                let [a, b, c] = [i, i + 1, i + 2].map(|k| points[p[k % p.len()]]);
                (b - a).perp(&(c - b)) > -1e-9
            });
            prop_assert!(pieces.iter().all(turns), "{pieces:?}");
        }
    }
}
