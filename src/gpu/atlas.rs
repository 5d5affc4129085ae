//! All shadow maps of a batch in one depth array texture: maps are halvings of the largest, so that square cells of a
//! layer each take one large map or 4, 16, … smaller ones.

use super::{Device, Problem};

/// Side of a layer where that is enough for a map, texels.
const LAYER_PX: usize = 1024;

/// Where a map lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Place {
    pub layer: u32,
    /// Its first column and row.
    pub corner: [u32; 2],
}

/// Size of an atlas.
#[derive(Debug, Clone, Copy)]
pub(super) struct Extent {
    /// Side of the largest map, texels.
    map_px: usize,
    /// Cells of that side along a layer.
    cells: usize,
    /// Most layers.
    layers: usize,
}

impl Extent {
    /// For maps of at most `map_px` texels along, `texels` in all or as many as the device allows.
    pub fn new(device: &Device, map_px: usize, texels: usize) -> Result<Self, Problem> {
        let limit = device.limits.max_texture_dimension_2d;
        device.allows("a shadow map, texels along its side,", map_px as u64, u64::from(limit))?;
        let cells = (LAYER_PX.min(limit as usize) / map_px).max(1);
        let most = device.limits.max_texture_array_layers as usize;
        let layers = (texels / (cells * map_px).pow(2)).clamp(1, most);
        Ok(Self { map_px, cells, layers })
    }

    /// Side of a layer, texels.
    pub fn side(&self) -> usize {
        self.cells * self.map_px
    }
}

/// Maps being placed in an empty atlas.
pub(super) struct Packing {
    extent: Extent,
    /// Cells that are taken.
    taken: usize,
    /// By number of halvings: the cell that is being filled, and how much of it is.
    open: Vec<Option<(usize, usize)>>,
}

impl Packing {
    pub fn new(extent: Extent) -> Self {
        Self { extent, taken: 0, open: Vec::new() }
    }

    /// Layers that are taken.
    pub fn layers(&self) -> usize {
        self.taken.div_ceil(self.extent.cells.pow(2))
    }

    /// A place for a map of `size` texels along, `None` where the atlas is full.
    pub fn place(&mut self, size: usize) -> Option<Place> {
        let Extent { map_px, cells, layers } = self.extent;
        let halvings = (map_px / size.max(1)).max(1).ilog2() as usize;
        let along = 1 << halvings;
        if self.open.len() <= halvings {
            self.open.resize(halvings + 1, None);
        }
        let (cell, used) = match self.open[halvings] {
            Some((cell, used)) if used < along * along => (cell, used),
            _ if self.taken == cells * cells * layers => return None,
            _ => {
                self.taken += 1;
                (self.taken - 1, 0)
            }
        };
        self.open[halvings] = Some((cell, used + 1));
        let (layer, cell) = (cell / (cells * cells), cell % (cells * cells));
        let texel = |cell: usize, slot: usize| (cell * map_px + slot * (map_px >> halvings)) as u32;
        let corner = [texel(cell % cells, used % along), texel(cell / cells, used / along)];
        Some(Place { layer: layer as u32, corner })
    }
}

/// The texture; grows to as many layers as a frame needs.
pub(super) struct Atlas {
    pub extent: Extent,
    pub texture: wgpu::Texture,
    /// All layers.
    pub view: wgpu::TextureView,
    /// Each layer.
    pub layers: Vec<wgpu::TextureView>,
}

impl Atlas {
    pub fn new(device: &Device, extent: Extent, layers: usize) -> Self {
        let texture = device.device.create_texture(&wgpu::TextureDescriptor {
            label: Some("shadow maps"),
            size: wgpu::Extent3d {
                width: extent.side() as u32,
                height: extent.side() as u32,
                depth_or_array_layers: layers as u32,
            },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: wgpu::TextureFormat::Depth32Float,
            usage: wgpu::TextureUsages::RENDER_ATTACHMENT
                | wgpu::TextureUsages::TEXTURE_BINDING
                | wgpu::TextureUsages::COPY_SRC,
            view_formats: &[],
        });
        let layer = |i: usize| wgpu::TextureViewDescriptor {
            dimension: Some(wgpu::TextureViewDimension::D2),
            base_array_layer: i as u32,
            array_layer_count: Some(1),
            ..Default::default()
        };
        let all = wgpu::TextureViewDescriptor {
            dimension: Some(wgpu::TextureViewDimension::D2Array),
            ..Default::default()
        };
        Self {
            extent,
            view: texture.create_view(&all),
            layers: (0..layers).map(|i| texture.create_view(&layer(i))).collect(),
            texture,
        }
    }

    /// Has at least so many layers afterwards; true where a new texture took the old one's place.
    pub fn reserve(&mut self, device: &Device, layers: usize) -> bool {
        let grows = layers > self.layers.len();
        if grows {
            let layers = layers.next_power_of_two().min(self.extent.layers);
            *self = Self::new(device, self.extent, layers);
        }
        grows
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn maps_lie_inside_and_never_over_each_other(
            map_px in 16usize..300, cells in 1usize..4, layers in 1usize..4,
            halvings in proptest::collection::vec(0u32..5, 1..200),
        ) {
            let extent = Extent { map_px, cells, layers };
            let mut packing = Packing::new(extent);
            let mut placed: Vec<(Place, u32)> = Vec::new();
            for size in halvings.iter().map(|h| map_px >> h).filter(|s| *s > 0) {
                let Some(place) = packing.place(size) else { break };
                prop_assert!((place.layer as usize) < packing.layers() && packing.layers() <= layers);
                let end = place.corner.map(|c| c as usize + size);
                prop_assert!(end.iter().all(|&e| e <= extent.side()));
                placed.push((place, size as u32));
            }
            for (i, (a, n)) in placed.iter().enumerate() {
                for (b, m) in &placed[..i] {
                    let apart = |k: usize| a.corner[k] + n <= b.corner[k] || b.corner[k] + m <= a.corner[k];
                    prop_assert!(a.layer != b.layer || apart(0) || apart(1), "{:?} {} {:?} {}", a, n, b, m);
                }
            }
        }

        #[test]
        fn an_atlas_holds_as_many_as_fit(map_px in 16usize..300, cells in 1usize..4, layers in 1usize..3, halvings in 0u32..3) {
            let mut packing = Packing::new(Extent { map_px, cells, layers });
            let count = (0..).take_while(|_| packing.place(map_px >> halvings).is_some()).count();
            prop_assert_eq!(count, (cells * cells * layers) << (2 * halvings));
        }
    }
}
