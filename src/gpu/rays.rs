//! Hierarchies of triangles on the device: that of the scene, which stays, and behind it that of an object.

use super::device::Buffer;
use super::layout::{Node, Triangle};
use super::{Device, Problem};
use crate::visibility::BinaryBvh;

/// Root of a hierarchy without triangles, as rays.wgsl has it.
pub(super) const NOTHING: u32 = u32::MAX;
/// Most levels that rays.wgsl can walk.
const DEPTH: u64 = 64;

/// Both, one behind the other.
pub(super) struct Hierarchies {
    scene: (Vec<Node>, Vec<Triangle>),
    nodes: Buffer,
    triangles: Buffer,
    /// Root of the object's.
    object: u32,
}

impl Hierarchies {
    pub fn new(device: &Device, scene: &BinaryBvh) -> Result<Self, Problem> {
        let storage = |label| Buffer::new(device, label, wgpu::BufferUsages::STORAGE);
        let mut hierarchies = Self {
            scene: laid_out(device, scene, [0, 0])?,
            nodes: storage("boxes around triangles, bytes,"),
            triangles: storage("triangles for rays, bytes,"),
            object: NOTHING,
        };
        hierarchies.write(device, &BinaryBvh::default())?;
        Ok(hierarchies)
    }

    /// Puts an object's behind the scene's; an empty one where no ray asks for it.
    pub fn write(&mut self, device: &Device, object: &BinaryBvh) -> Result<(), Problem> {
        let (mut nodes, mut triangles) = self.scene.clone();
        let starts = [nodes.len(), triangles.len()].map(|n| n as u32);
        self.object = if object.nodes.is_empty() { NOTHING } else { starts[0] };
        let (more, others) = laid_out(device, object, starts)?;
        nodes.extend(more);
        triangles.extend(others);
        self.nodes.write(device, bytemuck::cast_slice(&nodes))?;
        self.triangles.write(device, bytemuck::cast_slice(&triangles))?;
        Ok(())
    }

    /// Roots of the scene's and of the object's.
    pub fn roots(&self) -> [u32; 2] {
        [if self.scene.0.is_empty() { NOTHING } else { 0 }, self.object]
    }

    /// What rays.wgsl binds.
    pub fn resources(&self) -> [wgpu::BindingResource<'_>; 2] {
        [&self.nodes, &self.triangles].map(|b| b.get().as_entire_binding())
    }
}

/// As rays.wgsl reads them, where so many nodes and triangles lie before them.
fn laid_out(
    device: &Device,
    bvh: &BinaryBvh,
    [nodes, triangles]: [u32; 2],
) -> Result<(Vec<Node>, Vec<Triangle>), Problem> {
    device.allows("a hierarchy of triangles, levels,", bvh.depth() as u64, DEPTH)?;
    let node = |n: &crate::visibility::BinaryNode| Node {
        low: n.low.to_array(),
        count: n.count,
        high: n.high.to_array(),
        first: n.first + if n.count == 0 { nodes } else { triangles },
    };
    let triangle = |t: &[glam::Vec3; 3]| {
        let [a, b, c] = t.map(|v| v.to_array());
        Triangle { a, padding_a: 0, b, padding_b: 0, c, padding_c: 0 }
    };
    Ok((bvh.nodes.iter().map(node).collect(), bvh.triangles.iter().map(triangle).collect()))
}
