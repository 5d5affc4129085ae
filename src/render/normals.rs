//! Shading normals where a file has none.

use super::object::Soup;
use glam::Vec3;

/// For each triangle the unit normals of its corners: the file's, or the mean of the face normals around the corner
/// whose angle to this face is below `smooth_rad`, weighted by the angle they take up there (Thürmer and Wüthrich 1998).
pub(super) fn corner_normals(soup: &Soup, smooth_rad: f32) -> Vec<[Vec3; 3]> {
    let faces: Vec<Vec3> = soup
        .triangles
        .iter()
        .map(|t| {
            let [a, b, c] = t.positions.map(|i| soup.positions[i as usize]);
            (b - a).cross(c - a).normalize_or_zero()
        })
        .collect();
    let around = triangles_around(soup);
    let cos_smooth = smooth_rad.cos() - 1e-6;
    let smooth = |t: usize, corner: usize| -> Vec3 {
        let vertex = soup.triangles[t].positions[corner];
        let sum: Vec3 = around[vertex as usize]
            .iter()
            .filter(|&&(other, _)| other as usize == t || faces[other as usize].dot(faces[t]) >= cos_smooth)
            .map(|&(other, angle)| faces[other as usize] * angle)
            .sum();
        sum.try_normalize().unwrap_or(faces[t])
    };
    soup.triangles
        .iter()
        .enumerate()
        .map(|(t, triangle)| match triangle.normals {
            Some(normals) => {
                let normals: [Vec3; 3] =
                    std::array::from_fn(|c| normals[c].try_normalize().unwrap_or_else(|| smooth(t, c)));
                // A file may wind its triangles against its normals: the front is where the winding says.
                let turned = normals.iter().sum::<Vec3>().dot(faces[t]) < 0.0;
                normals.map(|n| if turned { -n } else { n })
            }
            None => std::array::from_fn(|c| smooth(t, c)),
        })
        .collect()
}

/// For each vertex the triangles at it, with the angle that each takes up there, rad.
fn triangles_around(soup: &Soup) -> Vec<Vec<(u32, f32)>> {
    let mut around = vec![Vec::new(); soup.positions.len()];
    for (t, triangle) in (0u32..).zip(&soup.triangles) {
        let p = triangle.positions.map(|i| soup.positions[i as usize]);
        for c in 0..3 {
            let angle = (p[(c + 1) % 3] - p[c]).angle_between(p[(c + 2) % 3] - p[c]);
            around[triangle.positions[c] as usize].push((t, angle));
        }
    }
    around
}

#[cfg(test)]
mod tests {
    use super::super::object::{Material, Object, Soup};
    use glam::Vec3;

    /// The cube −1..1, quads as two triangles each.
    pub(crate) fn cube() -> Soup {
        let mut soup = Soup {
            positions: (0..8)
                .map(|i| Vec3::new((i & 1) as f32, (i >> 1 & 1) as f32, (i >> 2 & 1) as f32) * 2.0 - 1.0)
                .collect(),
            materials: vec![Material {
                diffuse: [0.5; 3],
                specular: [0.0; 3],
                shininess: 1.0,
                roughness: None,
            }],
            ..Soup::default()
        };
        for quad in [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]] {
            soup.add_polygon(&quad, None, 0);
        }
        soup
    }

    #[test]
    fn edges_above_the_angle_stay_sharp() {
        let object = Object::new(cube(), 60f32.to_radians()).unwrap();
        assert_eq!(object.vertices.len(), 24, "three normals at each corner");
        for (i, t) in object.triangles.iter().enumerate() {
            let [a, b, c] = object.corners(i);
            let face = (b - a).cross(c - a).normalize();
            assert!(t.iter().all(|v| (object.normals[*v as usize] - face).length() < 1e-6));
        }
    }

    #[test]
    fn edges_below_the_angle_are_smooth_and_blind_to_the_triangulation() {
        let object = Object::new(cube(), 100f32.to_radians()).unwrap();
        assert_eq!(object.vertices.len(), 8);
        for (p, n) in object.vertices.iter().zip(&object.normals) {
            assert!((p.normalize() - *n).length() < 1e-6, "{p} {n}");
        }
    }

    #[test]
    fn the_file_has_the_last_word_unless_it_is_zero() {
        let mut soup = cube();
        let tilted = Vec3::new(0.1, 0.0, -1.0).normalize();
        let t = soup.triangles.iter().position(|t| t.positions == [0, 2, 3]).unwrap();
        soup.triangles[t].normals = Some([tilted, tilted, Vec3::ZERO]);
        let object = Object::new(soup, 0.1).unwrap();
        let n = object.triangles[t].map(|v| object.normals[v as usize]);
        assert!((n[0] - tilted).length() < 1e-6 && (n[2] + Vec3::Z).length() < 1e-6);
    }
}
