//! Structs as the shaders of `shaders/` see them.

use crate::occlusion::MOST_SLICES;
use bytemuck::{Pod, Zeroable};

/// `Frame` of shadow_map_types.wgsl.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub(crate) struct Frame {
    pub maps: u32,
    pub clusters: u32,
    pub side: u32,
    pub add: u32,
}

/// `ShadowMap` of shadow_map_types.wgsl.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub(crate) struct ShadowMap {
    pub map_from_world: [[f32; 4]; 4],
    pub planes: [[f32; 4]; 4],
    pub sides: [[f32; 4]; 5],
    pub offset: [f32; 2],
    pub weight: f32,
    pub cluster: u32,
    pub corner: [u32; 2],
    pub layer: u32,
    pub size: u32,
}

/// `Receiver` of receiver.wgsl.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub(crate) struct Receiver {
    pub position: [f32; 3],
    pub vertex_a: u32,
    pub normal: [f32; 3],
    pub vertex_b: u32,
    pub weights: [f32; 3],
    pub vertex_c: u32,
    pub across: [f32; 3],
    pub place: u32,
    pub down: [f32; 3],
    pub padding_b: u32,
    pub plate: [f32; 3],
    pub padding_c: u32,
    pub irradiance: [f32; 3],
    pub padding_d: u32,
}

/// `Tile` of subtract_transfers.wgsl.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub(crate) struct Tile {
    pub centre: [f32; 3],
    pub radius: f32,
    pub first: u32,
    pub count: u32,
    pub padding: [u32; 2],
}

/// `Textures` of occlusion_types.wgsl.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub(crate) struct Textures {
    pub light_from_world: [[f32; 4]; 4],
    pub radiance: [f32; 3],
    pub behind: f32,
    pub near: f32,
    pub size: u32,
    pub slices: u32,
    pub prefilter: u32,
    pub combination: u32,
    pub closed: u32,
    pub first: u32,
    pub layers: u32,
    pub stride: u32,
    pub last: u32,
    pub padding: [u32; 2],
    pub planes: [[f32; 4]; MOST_SLICES],
}

/// `Node` of rays.wgsl.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub(crate) struct Node {
    pub low: [f32; 3],
    pub count: u32,
    pub high: [f32; 3],
    pub first: u32,
}

/// `Triangle` of rays.wgsl.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub(crate) struct Triangle {
    pub a: [f32; 3],
    pub padding_a: u32,
    pub b: [f32; 3],
    pub padding_b: u32,
    pub c: [f32; 3],
    pub padding_c: u32,
}

/// `Light` of subtractive_hidden.wgsl.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub(crate) struct Light {
    pub origin: [f32; 3],
    pub kind: u32,
    pub power: [f32; 3],
    pub map: u32,
    pub normal: [f32; 3],
    pub padding_a: u32,
    pub reference: f32,
    pub spread: f32,
    pub half: f32,
    pub padding_b: u32,
}

/// `Sample` of subtractive_hidden.wgsl.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub(crate) struct Sample {
    pub position: [f32; 3],
    pub present: u32,
    pub normal: [f32; 3],
    pub padding: u32,
    pub value: [f32; 4],
}

/// `Detail` of subtractive_hidden.wgsl.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub(crate) struct Detail {
    pub lights: u32,
    pub scene: u32,
    pub object: u32,
    pub add: u32,
    pub side: u32,
    pub columns: u32,
    pub rows: u32,
    pub width: u32,
    pub last: u32,
    pub padding_a: u32,
    pub padding_b: [u32; 2],
}

/// `Work` of lookup_ceiling.wgsl.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub(crate) struct Work {
    pub lookups: u32,
    pub side: u32,
    pub layers: u32,
    pub width: u32,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::shaders;
    use std::mem::{offset_of, size_of};
    use wgpu::naga::TypeInner;

    /// Byte offset of each member and the stride of a struct, as naga lays it out.
    fn reflect(module: &wgpu::naga::Module, name: &str) -> (Vec<(String, u32)>, u32) {
        let of_name = |t: &&wgpu::naga::Type| t.name.as_deref().is_some_and(|n| n.starts_with(name));
        let (_, found) = module.types.iter().find(|(_, t)| of_name(t)).unwrap();
        match &found.inner {
            TypeInner::Struct { members, span } => {
                (members.iter().map(|m| (m.name.clone().unwrap(), m.offset)).collect(), *span)
            }
            other => panic!("{name} is {other:?}"),
        }
    }

    macro_rules! same_layout {
        ($module:expr, $type:ident { $($field:ident),* }) => {
            let (members, span) = reflect($module, stringify!($type));
            let ours = vec![$((stringify!($field).to_string(), offset_of!($type, $field) as u32)),*];
            assert_eq!(members, ours, stringify!($type));
            assert_eq!(span as usize, size_of::<$type>());
        };
    }

    #[test]
    fn structs_lie_as_the_shaders_read_them() {
        let module = &shaders::compose(shaders::SUBTRACT_TRANSFERS).unwrap().0;
        same_layout!(module, Frame { maps, clusters, side, add });
        same_layout!(
            module,
            ShadowMap { map_from_world, planes, sides, offset, weight, cluster, corner, layer, size }
        );
        same_layout!(
            module,
            Receiver {
                position,
                vertex_a,
                normal,
                vertex_b,
                weights,
                vertex_c,
                across,
                place,
                down,
                padding_b,
                plate,
                padding_c,
                irradiance,
                padding_d
            }
        );
        same_layout!(module, Tile { centre, radius, first, count, padding });
        let module = &shaders::compose(shaders::SHADOW_MAP).unwrap().0;
        same_layout!(module, Frame { maps, clusters, side, add });
        let module = &shaders::compose(shaders::OCCLUSION_COMBINE).unwrap().0;
        same_layout!(
            module,
            Textures {
                light_from_world,
                radiance,
                behind,
                near,
                size,
                slices,
                prefilter,
                combination,
                closed,
                first,
                layers,
                stride,
                last,
                padding,
                planes
            }
        );
        let module = &shaders::compose(shaders::SUBTRACTIVE_RESAMPLE).unwrap().0;
        same_layout!(module, Node { low, count, high, first });
        same_layout!(module, Triangle { a, padding_a, b, padding_b, c, padding_c });
        same_layout!(
            module,
            Light { origin, kind, power, map, normal, padding_a, reference, spread, half, padding_b }
        );
        same_layout!(module, Sample { position, present, normal, padding, value });
        same_layout!(
            module,
            Detail { lights, scene, object, add, side, columns, rows, width, last, padding_a, padding_b }
        );
        let module = &shaders::compose(shaders::LOOKUP_CEILING).unwrap().0;
        same_layout!(module, Work { lookups, side, layers, width });
    }
}
