//! Codes of a photograph a band of rows at a time, so that what uses them need not hold them all.

use crate::image::{Code, CodeImage, Image};
use std::borrow::Cow;
use std::fs::File;
use std::io::{Result, Write};
use std::ops::Range;
use std::os::unix::fs::FileExt;
use std::sync::atomic::{AtomicUsize, Ordering};

/// A photograph whose rows are read when they are needed.
pub trait Rows: Sync {
    /// `(width, height)`, px.
    fn size(&self) -> (usize, usize);

    /// The rows of a range, which lies within the picture, as they are held.
    fn strip(&self, range: Range<usize>) -> Result<Strip<'_>>;

    /// The same as codes.
    fn rows(&self, range: Range<usize>) -> Result<CodeImage> {
        let height = range.len();
        Ok(Image::from_pixels(self.size().0, height, self.strip(range)?.codes()))
    }

    /// Bits of a stored code, which tell how coarsely it is rounded.
    fn bits(&self) -> u32 {
        8
    }
}

/// Rows of a photograph as they are held: red, green, blue of each pixel.
#[derive(Debug, Clone, PartialEq)]
pub enum Strip<'a> {
    /// Of at most 8 bits.
    Eight(Cow<'a, [u8]>),
    /// Of more.
    Sixteen(Cow<'a, [u16]>),
    /// Codes, not of a number where the photograph does not reach.
    Codes(Cow<'a, [Code]>),
}

impl Strip<'_> {
    /// One channel of the `i`-th pixel.
    pub fn code(&self, i: usize, channel: usize) -> f32 {
        match self {
            Self::Eight(s) => of_eight(s[3 * i + channel]),
            Self::Sixteen(s) => of_sixteen(s[3 * i + channel]),
            Self::Codes(s) => s[i].0[channel],
        }
    }

    fn codes(self) -> Vec<Code> {
        match self {
            Self::Eight(s) => s.chunks_exact(3).map(|c| Code([c[0], c[1], c[2]].map(of_eight))).collect(),
            Self::Sixteen(s) => s.chunks_exact(3).map(|c| Code([c[0], c[1], c[2]].map(of_sixteen))).collect(),
            Self::Codes(s) => s.into_owned(),
        }
    }
}

fn of_eight(sample: u8) -> f32 {
    f32::from(sample) / 255.0
}

fn of_sixteen(sample: u16) -> f32 {
    f32::from(sample) / 65535.0
}

impl Rows for CodeImage {
    fn size(&self) -> (usize, usize) {
        CodeImage::size(self)
    }

    fn strip(&self, range: Range<usize>) -> Result<Strip<'_>> {
        let width = self.width();
        Ok(Strip::Codes(self.pixels()[range.start * width..range.end * width].into()))
    }
}

/// Samples of a photograph as its file holds them: red, green, blue of each pixel, row by row, upright.
#[derive(Debug, Clone, PartialEq)]
pub enum Samples {
    /// Of at most 8 bits.
    Eight(Vec<u8>),
    /// Of more.
    Sixteen(Vec<u16>),
}

/// A photograph as its file holds it.
#[derive(Debug, Clone, PartialEq)]
pub struct Stored {
    /// Width, px.
    pub width: usize,
    /// Height, px.
    pub height: usize,
    /// Three for each pixel.
    pub samples: Samples,
}

impl Rows for Stored {
    fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    fn strip(&self, range: Range<usize>) -> Result<Strip<'_>> {
        let part = range.start * self.width * 3..range.end * self.width * 3;
        Ok(match &self.samples {
            Samples::Eight(s) => Strip::Eight(s[part].into()),
            Samples::Sixteen(s) => Strip::Sixteen(s[part].into()),
        })
    }

    fn bits(&self) -> u32 {
        match self.samples {
            Samples::Eight(_) => 8,
            Samples::Sixteen(_) => 16,
        }
    }
}

/// A photograph put aside on the disk, in a file without a name that goes with it.
#[derive(Debug)]
pub struct Spooled {
    file: File,
    width: usize,
    height: usize,
    bytes: usize,
}

impl Spooled {
    /// Puts a photograph aside.
    pub fn new(stored: &Stored) -> Result<Self> {
        let mut file = tempfile::tempfile()?;
        let bytes = match &stored.samples {
            Samples::Eight(s) => {
                file.write_all(s)?;
                1
            }
            Samples::Sixteen(s) => {
                file.write_all(bytemuck::cast_slice(s))?;
                2
            }
        };
        Ok(Self { file, width: stored.width, height: stored.height, bytes })
    }
}

/// Memory in which photographs are kept, bytes; what does not fit is put aside on the disk.
#[derive(Debug)]
pub struct Room(AtomicUsize);

impl Room {
    /// Room for so many bytes.
    pub const fn new(bytes: usize) -> Self {
        Self(AtomicUsize::new(bytes))
    }

    /// Keeps a photograph in memory while there is room, and puts it aside otherwise.
    pub fn keep(&self, stored: Stored) -> Result<Box<dyn Rows + Send>> {
        let bytes = match &stored.samples {
            Samples::Eight(s) => s.len(),
            Samples::Sixteen(s) => 2 * s.len(),
        };
        let taken = self.0.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |left| left.checked_sub(bytes));
        if taken.is_ok() { Ok(Box::new(stored)) } else { Ok(Box::new(Spooled::new(&stored)?)) }
    }
}

impl Rows for Spooled {
    fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    fn strip(&self, range: Range<usize>) -> Result<Strip<'_>> {
        let row = self.width * 3;
        let (samples, offset) = (range.len() * row, (range.start * row * self.bytes) as u64);
        Ok(if self.bytes == 1 {
            let mut bytes = vec![0; samples];
            self.file.read_exact_at(&mut bytes, offset)?;
            Strip::Eight(bytes.into())
        } else {
            let mut words = vec![0_u16; samples];
            self.file.read_exact_at(bytemuck::cast_slice_mut(&mut words), offset)?;
            Strip::Sixteen(words.into())
        })
    }

    fn bits(&self) -> u32 {
        8 * self.bytes as u32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_the_same_however_they_are_held() {
        let values: Vec<u16> = (0..4 * 5 * 3).map(|i| i * 1000).collect();
        let stored = Stored { width: 4, height: 5, samples: Samples::Sixteen(values.clone()) };
        let whole = stored.rows(0..5).unwrap();
        assert_eq!(whole.at(1, 2).0, [27, 28, 29].map(|i| f32::from(values[i]) / 65535.0));
        let spooled = Spooled::new(&stored).unwrap();
        for part in [0..5, 1..3, 4..5, 2..2] {
            let expected = stored.rows(part.clone()).unwrap();
            assert_eq!(Rows::rows(&whole, part.clone()).unwrap(), expected);
            assert_eq!(spooled.rows(part).unwrap(), expected);
        }
        let room = Room::new(250);
        for left in [130, 10, 10] {
            let kept = room.keep(stored.clone()).unwrap();
            assert_eq!(
                (room.0.load(Ordering::Relaxed), kept.rows(1..3).unwrap()),
                (left, stored.rows(1..3).unwrap())
            );
        }
        let eight = Stored { width: 4, height: 5, samples: Samples::Eight((0..60).collect()) };
        assert_eq!(Spooled::new(&eight).unwrap().rows(3..5).unwrap(), eight.rows(3..5).unwrap());
        assert_eq!(eight.rows(0..1).unwrap().at(1, 0).0, [3.0 / 255.0, 4.0 / 255.0, 5.0 / 255.0]);
    }
}
