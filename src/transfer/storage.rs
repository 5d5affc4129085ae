//! Transfers on disk: `transfer.json` for a reader's eye, arrays beside it.

mod hierarchy;

use super::receivers::{Part, ReceiverMesh, Split};
use super::{Links, ShaftCounts, ShaftHierarchy, Source, SourceKind, SourceNode, SourceTree, Transfers};
use crate::artefact::json::{self, JsonArtefact};
use crate::artefact::npy::{self, Element};
use crate::artefact::remake;
use crate::error::{Error, Result};
use glam::Vec3;
use hierarchy::{
    boxes_array, octree_array, read_octree, read_shafts, read_source_boxes, shafts_array, source_boxes_array,
};
use ndarray::{Array1, Array2};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// `transfer.json`.
#[derive(Serialize, Deserialize)]
struct Index {
    sources: usize,
    left_out: usize,
    left_out_share: f64,
    largest_left_out_share: f64,
    receiver_patches: usize,
    receiver_vertices: usize,
    links: usize,
}

impl JsonArtefact for Index {
    const FORMAT: &'static str = "insitu-transfer";
    const VERSION: u32 = 2;
}

/// `hierarchy.json`: what the arrays of the hierarchies hold.
#[derive(Serialize, Deserialize)]
struct Hierarchy {
    #[serde(flatten)]
    counts: ShaftCounts,
}

impl JsonArtefact for Hierarchy {
    const FORMAT: &'static str = "insitu-hierarchy";
    const VERSION: u32 = 1;
}

/// Stands for "none" among indices.
const NONE: u32 = u32::MAX;

/// Reads arrays and holds them to their sizes.
struct Folder<'a>(&'a Path);

impl Folder<'_> {
    fn refuse(&self, name: &str, problem: String) -> Error {
        let path: PathBuf = self.0.join(name);
        Error::file("reading the transfers", &path, problem, remake(&path))
    }

    fn rows<T: Element>(&self, name: &str, expected: (usize, usize)) -> Result<Array2<T>> {
        let array: Array2<T> = npy::read(&self.0.join(name))?;
        match array.dim() {
            found if found == expected => Ok(array),
            found => Err(self.refuse(name, format!("is {found:?} large, transfer.json says {expected:?}"))),
        }
    }

    /// Any number of rows.
    fn table<T: Element>(&self, name: &str, columns: usize) -> Result<Array2<T>> {
        let array: Array2<T> = npy::read(&self.0.join(name))?;
        match array.ncols() {
            found if found == columns => Ok(array),
            found => Err(self.refuse(name, format!("has {found} columns, expected {columns}"))),
        }
    }

    fn list(&self, name: &str, expected: usize) -> Result<Vec<u32>> {
        let array: Array1<u32> = npy::read(&self.0.join(name))?;
        match array.len() {
            found if found == expected => Ok(array.to_vec()),
            found => Err(self.refuse(name, format!("is {found} long, transfer.json says {expected}"))),
        }
    }

    fn hierarchy(&self, files: [&str; 6], sources: usize, patches: usize) -> Result<ShaftHierarchy> {
        let [_, shafts, source_boxes, octree, boxes, order] = files;
        let nodes: Array2<u32> = self.table(octree, 4)?;
        let boxes = self.rows(boxes, (nodes.nrows(), 6))?;
        let receivers = read_octree(&nodes, &boxes, self.list(order, patches)?);
        let receivers =
            receivers.ok_or_else(|| self.refuse(octree, "damaged: nodes do not form a tree".into()))?;
        let shafts_found = read_shafts(&self.table(shafts, 4)?, sources, nodes.nrows());
        Ok(ShaftHierarchy {
            shafts: shafts_found.ok_or_else(|| self.refuse(shafts, "damaged: shafts without ends".into()))?,
            sources: read_source_boxes(&self.rows(source_boxes, (sources, 7))?),
            receivers,
        })
    }

    fn hold(&self, name: &str, holds: bool, what: &str) -> Result<()> {
        if holds { Ok(()) } else { Err(self.refuse(name, format!("damaged: {what}"))) }
    }
}

impl Transfers {
    /// Names of the files in a stage's folder.
    pub const FILES: [&'static str; 15] = [
        "transfer.json",
        "sources.npy",
        "source_tree.npy",
        "receivers.npy",
        "receiver_parts.npy",
        "links_first.npy",
        "links_node.npy",
        "links_irradiance.npy",
        "irradiance.npy",
        "hierarchy.json",
        "shafts.npy",
        "source_boxes.npy",
        "receiver_tree.npy",
        "receiver_boxes.npy",
        "receiver_order.npy",
    ];

    /// Writes the files into a folder.
    pub fn write(&self, folder: &Path) -> Result<()> {
        let index = Index {
            sources: self.sources.len(),
            left_out: self.left_out,
            left_out_share: self.left_out_share,
            largest_left_out_share: self.largest_left_out_share,
            receiver_patches: self.receivers.patches.len(),
            receiver_vertices: self.receivers.positions.len(),
            links: self.links.node.len(),
        };
        let [a, sources, tree, receivers, parts, first, node, light, irradiance, rest @ ..] =
            Self::FILES.map(|f| folder.join(f));
        json::write(&a, &index)?;
        npy::write(&sources, &sources_array(&self.sources))?;
        npy::write(&tree, &tree_array(&self.tree))?;
        npy::write(&receivers, &receivers_array(&self.receivers))?;
        npy::write(&parts, &parts_array(&self.receivers))?;
        npy::write(&first, &Array1::from(self.links.first.clone()))?;
        npy::write(&node, &Array1::from(self.links.node.clone()))?;
        let rgb = &self.links.irradiance;
        npy::write(&light, &Array2::from_shape_fn((rgb.len(), 3), |(i, c)| rgb[i][c]))?;
        npy::write(&irradiance, &self.irradiance)?;
        let [hierarchy, shafts, source_boxes, octree, boxes, order] = rest;
        json::write(&hierarchy, &Hierarchy { counts: self.shaft_counts() })?;
        npy::write(&shafts, &shafts_array(&self.shafts))?;
        npy::write(&source_boxes, &source_boxes_array(&self.shafts))?;
        npy::write(&octree, &octree_array(&self.shafts.receivers))?;
        npy::write(&boxes, &boxes_array(&self.shafts.receivers))?;
        npy::write(&order, &Array1::from(self.shafts.receivers.order.clone()))
    }

    /// Reads the files of a folder; refuses arrays that do not fit each other.
    pub fn read(folder: &Path) -> Result<Self> {
        let [a, sources, tree, receivers, parts, first, node, light, irradiance, rest @ ..] = Self::FILES;
        let index: Index = json::read(&folder.join(a))?;
        let folder = Folder(folder);
        let vertices = index.receiver_vertices;
        let sources = read_sources(&folder.rows(sources, (index.sources, 4))?);
        let nodes: Array2<u32> = folder.rows(tree, ((2 * index.sources).saturating_sub(1), 4))?;
        folder.hold(tree, tree_is_whole(&nodes, index.sources as u32), "nodes do not form a tree")?;
        let points = folder.rows(receivers, (vertices, 6))?;
        let table: Array2<u32> = folder.table(parts, 6)?;
        let mesh = read_receivers(&points, &table, index.receiver_patches);
        let mesh = mesh.ok_or_else(|| folder.refuse(parts, "damaged: parts without vertices".into()))?;
        let links = Links {
            first: folder.list(first, vertices + 1)?,
            node: folder.list(node, index.links)?,
            irradiance: folder
                .rows(light, (index.links, 3))?
                .outer_iter()
                .map(|r| [r[0], r[1], r[2]])
                .collect(),
        };
        let ends = (links.first.first(), links.first.last()) == (Some(&0), Some(&(index.links as u32)));
        folder.hold(first, ends && links.first.is_sorted(), "rows out of order")?;
        folder.hold(
            node,
            links.node.iter().all(|&n| (n as usize) < nodes.nrows()),
            "nodes that do not exist",
        )?;
        let shafts = folder.hierarchy(rest, nodes.nrows(), index.receiver_patches)?;
        Ok(Self {
            tree: read_tree(&nodes, &sources),
            sources,
            receivers: mesh,
            links,
            irradiance: folder.rows(irradiance, (vertices, 3))?,
            shafts,
            left_out: index.left_out,
            left_out_share: index.left_out_share,
            largest_left_out_share: index.largest_left_out_share,
        })
    }
}

/// [sources × (0 patch or 1 distant, index, share of power, average transfer)].
fn sources_array(sources: &[Source]) -> Array2<f64> {
    let row = |s: &Source| {
        let (kind, index) = match s.kind {
            SourceKind::Patch(i) => (0.0, i),
            SourceKind::Distant(i) => (1.0, i),
        };
        [kind, f64::from(index), s.power_share, s.mean]
    };
    Array2::from(sources.iter().map(row).collect::<Vec<_>>())
}

fn read_sources(array: &Array2<f64>) -> Vec<Source> {
    array
        .outer_iter()
        .map(|r| {
            let index = r[1] as u32;
            let kind = if r[0] == 0.0 { SourceKind::Patch(index) } else { SourceKind::Distant(index) };
            Source { kind, power_share: r[2], mean: r[3] }
        })
        .collect()
}

/// [nodes × (first leaf, end, child, child)].
fn tree_array(tree: &SourceTree) -> Array2<u32> {
    let row = |n: &SourceNode| {
        let [a, b] = n.children.unwrap_or([NONE; 2]);
        [n.leaves.start, n.leaves.end, a, b]
    };
    Array2::from(tree.nodes.iter().map(row).collect::<Vec<_>>())
}

/// Whether the rows are a depth-first binary tree over so many leaves.
fn tree_is_whole(nodes: &Array2<u32>, leaves: u32) -> bool {
    let n = nodes.nrows() as u32;
    let inner = |i: u32, r: &[u32; 4]| {
        let [start, end, a, b] = *r;
        if (a, b) == (NONE, NONE) {
            return end == start.wrapping_add(1) && end <= leaves;
        }
        if a <= i || b <= i || a >= n || b >= n {
            return false;
        }
        let (x, y) = (nodes.row(a as usize), nodes.row(b as usize));
        (x[0], x[1], y[1]) == (start, y[0], end)
    };
    let root = nodes.outer_iter().next().is_none_or(|r| (r[0], r[1]) == (0, leaves));
    root && nodes.outer_iter().zip(0..).all(|(r, i)| inner(i, &[r[0], r[1], r[2], r[3]]))
}

fn read_tree(nodes: &Array2<u32>, sources: &[Source]) -> SourceTree {
    let node = |r: ndarray::ArrayView1<u32>| SourceNode {
        leaves: r[0]..r[1],
        children: (r[2] != NONE).then_some([r[2], r[3]]),
        mean: 0.0,
    };
    let mut tree = SourceTree { nodes: nodes.outer_iter().map(node).collect() };
    tree.sum_means(sources);
    tree
}

/// [vertices × (position, normal)].
fn receivers_array(receivers: &ReceiverMesh) -> Array2<f32> {
    let both = receivers.positions.iter().zip(&receivers.normals);
    Array2::from(both.map(|(p, n)| [p.x, p.y, p.z, n.x, n.y, n.z]).collect::<Vec<_>>())
}

/// [parts × (three vertices, split edge, first part, patch)].
fn parts_array(receivers: &ReceiverMesh) -> Array2<u32> {
    let patches = receivers.patches.iter().copied().chain(std::iter::repeat(NONE));
    let row = |(part, patch): (&Part, u32)| {
        let [a, b, c] = part.vertices;
        let (edge, first) = part.split.map_or((NONE, NONE), |s| (u32::from(s.edge), s.first));
        [a, b, c, edge, first, patch]
    };
    Array2::from(receivers.parts.iter().zip(patches).map(row).collect::<Vec<_>>())
}

fn read_receivers(points: &Array2<f32>, parts: &Array2<u32>, patches: usize) -> Option<ReceiverMesh> {
    let (vertices, count) = (points.nrows() as u32, parts.nrows() as u32);
    let part = |(r, i): (ndarray::ArrayView1<u32>, u32)| {
        let split = (r[3] != NONE).then_some(Split { edge: r[3] as u8, first: r[4] });
        let whole = split.is_none_or(|s| r[3] < 3 && s.first > i && s.first < count - 1)
            && (0..3).all(|k| r[k] < vertices);
        whole.then_some(Part { vertices: [r[0], r[1], r[2]], split })
    };
    let at = |k: usize| points.outer_iter().map(move |r| Vec3::new(r[k], r[k + 1], r[k + 2])).collect();
    let patches: Vec<u32> = parts.outer_iter().take(patches).map(|r| r[5]).collect();
    let parts: Vec<Part> = parts.outer_iter().zip(0..).map(part).collect::<Option<_>>()?;
    if !patches.is_sorted() || parts.len() < patches.len() {
        return None;
    }
    let mut mesh = ReceiverMesh { positions: at(0), normals: at(3), triangles: Vec::new(), patches, parts };
    mesh.list_triangles();
    Some(mesh)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transfer::boxes::Box3;
    use crate::transfer::octree::{ReceiverNode, ReceiverTree};
    use crate::transfer::shafts::ShaftNode;
    use crate::transfer::tree::Extent;

    fn sample() -> Transfers {
        let sources = vec![
            Source { kind: SourceKind::Patch(3), power_share: 0.6, mean: 2.0 },
            Source { kind: SourceKind::Distant(0), power_share: 0.3, mean: 1.0 },
        ];
        let node = |leaves, children, mean| SourceNode { leaves, children, mean };
        let mut receivers = ReceiverMesh {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::Z, Vec3::X / 2.0],
            normals: vec![Vec3::Y; 4],
            triangles: Vec::new(),
            patches: vec![1],
            parts: vec![
                Part { vertices: [0, 1, 2], split: Some(Split { edge: 0, first: 1 }) },
                Part { vertices: [0, 3, 2], split: None },
                Part { vertices: [3, 1, 2], split: None },
            ],
        };
        receivers.list_triangles();
        let bounds = Box3::of([Vec3::ZERO, Vec3::ONE]);
        let hierarchy = ShaftHierarchy {
            shafts: vec![
                ShaftNode { source: 0, receiver: 0, first: 1, count: 1 },
                ShaftNode { source: 1, receiver: 0, first: 0, count: 0 },
            ],
            sources: vec![Extent::Both, Extent::Patches(bounds), Extent::Distant(bounds)],
            receivers: ReceiverTree {
                nodes: vec![ReceiverNode { bounds, children: 0..0, patches: 0..1 }],
                order: vec![0],
            },
        };
        Transfers {
            sources,
            tree: SourceTree {
                nodes: vec![node(0..2, Some([1, 2]), 3.0), node(0..1, None, 2.0), node(1..2, None, 1.0)],
            },
            receivers,
            links: Links {
                first: vec![0, 1, 1, 3, 3],
                node: vec![0, 1, 2],
                irradiance: vec![[0.1; 3], [0.2; 3], [0.3; 3]],
            },
            irradiance: Array2::ones((4, 3)),
            shafts: hierarchy,
            left_out: 4,
            left_out_share: 0.1,
            largest_left_out_share: 0.2,
        }
    }

    #[test]
    fn files_give_back_what_was_written() {
        let folder = tempfile::tempdir().unwrap();
        sample().write(folder.path()).unwrap();
        assert_eq!(Transfers::read(folder.path()).unwrap(), sample());
    }

    #[test]
    fn arrays_of_another_run_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let refused = |name: &str, write: &dyn Fn(&Path)| {
            sample().write(folder.path()).unwrap();
            write(&folder.path().join(name));
            Transfers::read(folder.path()).unwrap_err().to_string()
        };
        let e = refused("irradiance.npy", &|p| npy::write(p, &Array2::<f32>::zeros((2, 4))).unwrap());
        assert!(e.contains("irradiance.npy: is (2, 4) large, transfer.json says (4, 3)"), "{e}");
        let e = refused("source_tree.npy", &|p| {
            npy::write(p, &Array2::from(vec![[0, 2, 1, 2], [0, 1, NONE, NONE], [0, 1, NONE, NONE]])).unwrap();
        });
        assert!(e.contains("source_tree.npy: damaged: nodes do not form a tree"), "{e}");
        let e = refused("links_node.npy", &|p| npy::write(p, &Array1::from(vec![0u32, 1, 9])).unwrap());
        assert!(e.contains("links_node.npy: damaged: nodes that do not exist"), "{e}");
        let e =
            refused("links_first.npy", &|p| npy::write(p, &Array1::from(vec![0u32, 2, 1, 3, 3])).unwrap());
        assert!(e.contains("links_first.npy: damaged: rows out of order"), "{e}");
        let e = refused("receiver_parts.npy", &|p| {
            npy::write(p, &Array2::from(vec![[0, 1, 2, 0, 0, 1]])).unwrap();
        });
        assert!(e.contains("receiver_parts.npy: damaged"), "{e}");
        let e = refused("shafts.npy", &|p| {
            npy::write(p, &Array2::from(vec![[0u32, 0, 1, 1], [1, 7, 0, 0]])).unwrap()
        });
        assert!(e.contains("shafts.npy: damaged: shafts without ends"), "{e}");
    }
}
