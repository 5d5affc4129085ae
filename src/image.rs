//! Images as typed rasters. What a camera stored ([`Code`]) and what the scene sent ([`Radiance`]) are different types.

use rayon::prelude::*;

/// A row-major raster; `(0, 0)` is the top-left pixel, whose centre lies at `(0.5, 0.5)` px.
#[derive(Debug, Clone, PartialEq)]
pub struct Image<P> {
    width: usize,
    height: usize,
    pixels: Vec<P>,
}

/// Code values of a camera, in `0..=1` (stored value over the largest of its bit depth), one per channel.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Code(pub [f32; 3]);

/// Linear, scene-referred radiance in Rec. 709 primaries, relative to the exposure of the plate.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Radiance(pub [f32; 3]);

/// A photograph as stored.
pub type CodeImage = Image<Code>;
/// A linear picture.
pub type RadianceImage = Image<Radiance>;

impl Radiance {
    /// Rec. 709 luminance.
    pub fn luminance(self) -> f32 {
        luminance(self.0)
    }
}

/// Rec. 709 luminance of a linear triple (ITU-R BT.709, item 3.2).
pub fn luminance(rgb: [f32; 3]) -> f32 {
    0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2]
}

impl<P> Image<P> {
    /// Wraps pixels in row-major order. Panics if the count is not `width × height`: a caller's bug.
    pub fn from_pixels(width: usize, height: usize, pixels: Vec<P>) -> Self {
        assert_eq!(pixels.len(), width * height, "pixel count of an image");
        Self { width, height, pixels }
    }

    /// Evaluates `f(x, y)` at every pixel.
    pub fn from_fn(width: usize, height: usize, mut f: impl FnMut(usize, usize) -> P) -> Self {
        let pixels = (0..width * height).map(|i| f(i % width, i / width)).collect();
        Self { width, height, pixels }
    }

    /// One value everywhere.
    pub fn filled(width: usize, height: usize, value: P) -> Self
    where
        P: Clone,
    {
        Self { width, height, pixels: vec![value; width * height] }
    }

    /// Width, px.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Height, px.
    pub fn height(&self) -> usize {
        self.height
    }

    /// `(width, height)`, px.
    pub fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// All pixels, row by row.
    pub fn pixels(&self) -> &[P] {
        &self.pixels
    }

    /// All pixels, row by row.
    pub fn into_pixels(self) -> Vec<P> {
        self.pixels
    }

    /// All pixels, row by row.
    pub fn pixels_mut(&mut self) -> &mut [P] {
        &mut self.pixels
    }

    /// Pixel in column `x`, row `y`.
    pub fn at(&self, x: usize, y: usize) -> &P {
        &self.pixels[y * self.width + x]
    }

    /// Pixel in column `x`, row `y`.
    pub fn at_mut(&mut self, x: usize, y: usize) -> &mut P {
        &mut self.pixels[y * self.width + x]
    }

    /// Applies `f` to every pixel.
    pub fn map<Q>(&self, f: impl FnMut(&P) -> Q) -> Image<Q> {
        Image { width: self.width, height: self.height, pixels: self.pixels.iter().map(f).collect() }
    }
}

impl<P: Sync> Image<P> {
    /// The same by all threads.
    pub fn par_map<Q: Send>(&self, f: impl Fn(&P) -> Q + Sync + Send) -> Image<Q> {
        Image { width: self.width, height: self.height, pixels: self.pixels.par_iter().map(f).collect() }
    }
}

impl RadianceImage {
    /// Bilinear lookup at continuous pixel coordinates (centres at +0.5), clamped at the border.
    pub fn bilinear(&self, x: f64, y: f64) -> Radiance {
        let fx = (x - 0.5).clamp(0.0, (self.width - 1) as f64);
        let fy = (y - 0.5).clamp(0.0, (self.height - 1) as f64);
        let (x0, y0) = (fx as usize, fy as usize);
        let (x1, y1) = ((x0 + 1).min(self.width - 1), (y0 + 1).min(self.height - 1));
        let (ax, ay) = ((fx - x0 as f64) as f32, (fy - y0 as f64) as f32);
        let (a, b, c, d) = (self.at(x0, y0).0, self.at(x1, y0).0, self.at(x0, y1).0, self.at(x1, y1).0);
        Radiance(std::array::from_fn(|k| {
            (a[k] * (1.0 - ax) + b[k] * ax) * (1.0 - ay) + (c[k] * (1.0 - ax) + d[k] * ax) * ay
        }))
    }
}
