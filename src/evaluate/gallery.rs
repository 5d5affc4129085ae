//! The pictures of the report.

use super::compare::{Comparison, Ours};
use super::errors::difference;
use super::pictures::{ErrorMap, error_map, range, removal_map};
use crate::composite::view;
use crate::image::CodeImage;

/// Pictures and maps with their captions.
#[derive(Debug, Clone)]
pub struct Gallery {
    /// Side by side.
    pub pictures: Vec<(&'static str, CodeImage)>,
    /// In false colour.
    pub maps: Vec<(&'static str, ErrorMap)>,
}

impl Gallery {
    /// Size of the pictures, px.
    pub fn size(&self) -> (usize, usize) {
        self.pictures.first().map_or((0, 0), |(_, image)| image.size())
    }
}

/// Plate, augmented and reference as displayed; ε and, on the same range, its error.
pub fn gallery(
    ours: &Ours,
    comparison: Option<&Comparison>,
    encode: impl Fn([f32; 3]) -> [f32; 3],
) -> Gallery {
    let removed = difference(ours.plate, ours.composite);
    let range = range(&removed);
    let mut pictures =
        vec![("plate", view(ours.plate, 0.0, &encode)), ("augmented", view(ours.composite, 0.0, &encode))];
    let mut maps = Vec::new();
    if let Some(c) = comparison {
        pictures.push(("reference", view(&c.with, 0.0, &encode)));
        maps.push((
            "ε − ε*, luminance in plate units: blue where too little was removed, red where too much",
            error_map(&c.removal_error, range),
        ));
    }
    let caption = "ε = plate − augmented, luminance in plate units";
    maps.push((caption, removal_map(&removed, range)));
    Gallery { pictures, maps }
}
