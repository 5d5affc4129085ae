//! Roles of photographs whose names tell none, from what they show and how they were exposed.

use super::views::{Thumbnail, views};
use super::{Header, Photograph, decode};
use crate::calibrate;
use crate::config::{self, Role};
use crate::error::Result;
use std::collections::BTreeMap;
use std::path::Path;

/// What is known of a photograph whose name tells nothing.
#[derive(Debug, Clone)]
pub struct Seen {
    /// Its header.
    pub header: Header,
    /// Its content.
    pub thumbnail: Thumbnail,
    /// Whether it shows the printed grid.
    pub grid: bool,
}

/// Looks at a photograph; at linear pictures too, which are told by their names and sizes alone.
pub fn look(path: &Path, header: Header, grid: &config::Calibrate) -> Result<Seen> {
    let (thumbnail, grid) = match decode(path)? {
        Photograph::Codes(codes) => (Thumbnail::new(&codes), calibrate::shows_grid(&codes, grid)),
        Photograph::Linear(_) => (Thumbnail::dark(), false),
    };
    Ok(Seen { header, thumbnail, grid })
}

/// Roles by views: a view with several exposures is a series. Of two series the one that shows the grid is the probe's,
/// or else the later one; of one alone with a photograph beside it of an exposure that it has already, too: that one is the
/// empty scene. What else shows the grid from the plate's place has it with the plate, all others have the grid alone.
pub fn guess(photographs: &BTreeMap<String, Seen>) -> BTreeMap<Role, Vec<String>> {
    let files = of_one_size(photographs);
    let mut scenes: Vec<Scene> =
        views(&files.iter().map(|f| (&f.1.header, &f.1.thumbnail)).collect::<Vec<_>>())
            .into_iter()
            .map(|view| Scene::new(view.into_iter().map(|i| files[i]).collect()))
            .collect();
    if scenes.iter().all(|s| s.series.is_empty()) {
        // Hardly anything is seen in common: what was stepped through is a series all the same.
        scenes = vec![Scene::new(files)];
    }
    let (mut series, singles): (Vec<&Scene>, Vec<&Scene>) = scenes.iter().partition(|s| !s.series.is_empty());
    // A stable sort: those of the same kind stay in the order in which they were taken.
    series.sort_by_key(|s| s.shows_grid());
    let mut roles = BTreeMap::new();
    let names = |of: &[File]| of.iter().map(|f| f.0.to_string()).collect::<Vec<_>>();
    if let Some(place) = series.first().or(singles.first()) {
        let (with_grid, empty): (Vec<File>, Vec<File>) = place.beside.iter().partition(|f| f.1.grid);
        let own = if empty.is_empty() { place.middle() } else { empty.first().copied() };
        roles.extend(own.map(|f| (Role::Plate, names(&[f]))));
        let alone = series.len() == 1 && !empty.is_empty();
        let role = if alone { Role::Probe } else { Role::Brackets };
        roles.insert(role, names(&place.series));
        roles.insert(Role::PlateWithGrid, names(&with_grid));
    }
    if let Some(probe) = series.get(1) {
        roles.insert(Role::Probe, names(&probe.series));
    }
    // A view of the grid may resemble the probe's.
    let others = series.iter().skip(1).chain(singles.iter().skip(usize::from(series.is_empty())));
    let mut grids: Vec<File> = others.flat_map(|s| &s.beside).filter(|f| f.1.grid).copied().collect();
    grids.sort_by_cached_key(|(name, _)| by_number(name));
    roles.insert(Role::Grid, names(&grids));
    roles.retain(|_, files| !files.is_empty());
    roles
}

type File<'a> = (&'a str, &'a Seen);

/// The largest photographs, in the order of their names.
fn of_one_size(photographs: &BTreeMap<String, Seen>) -> Vec<File<'_>> {
    // Masks, drawings and finished pictures state no exposure; photographs do.
    let stated = photographs.values().any(|p| p.header.time_s.is_some());
    let photographs = || photographs.iter().filter(|(_, p)| !stated || p.header.time_s.is_some());
    let area = |h: &Header| u64::from(h.width_px) * u64::from(h.height_px);
    let largest = photographs().map(|(_, p)| area(&p.header)).max().unwrap_or(0);
    let size = photographs().find(|(_, p)| area(&p.header) == largest).map(|(_, p)| p.header.upright_size());
    let of_size = photographs().filter(|(_, p)| Some(p.header.upright_size()) == size);
    let mut files: Vec<File> = of_size.map(|(name, p)| (name.as_str(), p)).collect();
    files.sort_by_cached_key(|(name, _)| by_number(name));
    files
}

/// Photographs of one view: a series of exposures, and what lies beside it.
struct Scene<'a> {
    series: Vec<File<'a>>,
    beside: Vec<File<'a>>,
}

impl<'a> Scene<'a> {
    /// The longest run of rising or falling exposures is the series, unless the exposures are in no order: then one of each.
    fn new(files: Vec<File<'a>>) -> Self {
        let mut run = 0..0;
        for rising in [true, false] {
            let mut start = 0;
            for i in 1..=files.len() {
                let on = i < files.len() && steps(&files[i - 1].1.header, &files[i].1.header, rising);
                if !on {
                    if i - start >= 2 && i - start > run.len() {
                        run = start..i;
                    }
                    start = i;
                }
            }
        }
        let mut one_of_each: Vec<usize> = Vec::new();
        for (i, (_, p)) in files.iter().enumerate() {
            let first = one_of_each.first().map_or(&p.header, |k| &files[*k].1.header);
            let differs = |k: &usize| steps_apart(&files[*k].1.header, &p.header);
            let of_series = !p.grid || files.iter().all(|f| f.1.grid);
            let exposed = p.header.time_s.is_some() && alike(first, &p.header);
            if of_series && exposed && one_of_each.iter().all(differs) {
                one_of_each.push(i);
            }
        }
        let chosen = if run.len() < one_of_each.len() { one_of_each } else { run.collect() };
        let chosen = if chosen.len() < 2 { Vec::new() } else { chosen };
        let (series, beside): (Vec<_>, Vec<_>) =
            files.into_iter().enumerate().partition(|(i, _)| chosen.contains(i));
        let files = |of: Vec<(usize, File<'a>)>| of.into_iter().map(|(_, f)| f).collect();
        Self { series: files(series), beside: files(beside) }
    }

    fn shows_grid(&self) -> bool {
        self.series.iter().any(|f| f.1.grid)
    }

    /// The middle of its exposures, or the first of what is no series.
    fn middle(&self) -> Option<File<'a>> {
        let mut by_time = self.series.clone();
        by_time.sort_by(|a, b| {
            let time = |f: &File| f.1.header.time_s.unwrap_or(0.0);
            time(b).total_cmp(&time(a))
        });
        by_time.get(by_time.len() / 2).or(self.beside.first()).copied()
    }
}

/// Taken with one setting of the camera but for the exposure time, on the same day.
fn alike(a: &Header, b: &Header) -> bool {
    let setting = |h: &Header| (h.camera.clone(), h.focal_mm, h.f_number, h.iso);
    let day = |h: &Header| h.date.as_ref().and_then(|d| d.get(..10).map(String::from));
    day(a).zip(day(b)).is_none_or(|(a, b)| a == b) && setting(a) == setting(b)
}

/// Whether exposure times differ by more than rounding.
fn steps_apart(a: &Header, b: &Header) -> bool {
    a.time_s.zip(b.time_s).is_some_and(|(a, b)| (a / b).ln().abs() > 0.05)
}

/// Whether only the exposure time rises (or falls) from one photograph to the next.
fn steps(a: &Header, b: &Header, rising: bool) -> bool {
    let stepped = a.time_s.zip(b.time_s).is_some_and(|(a, b)| if rising { b > a } else { b < a });
    stepped && alike(a, b)
}

/// Sorts `5.jpg` before `10.jpg`: the text before each number, and the number.
fn by_number(name: &str) -> Vec<(String, u64)> {
    let mut key = vec![(String::new(), 0_u64)];
    let mut after_digit = false;
    for c in name.chars() {
        if after_digit && !c.is_ascii_digit() {
            key.push((String::new(), 0));
        }
        after_digit = c.is_ascii_digit();
        if let Some((text, number)) = key.last_mut() {
            match c.to_digit(10) {
                Some(digit) => *number = number.saturating_mul(10).saturating_add(u64::from(digit)),
                None => text.push(c),
            }
        }
    }
    key
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::{Code, Image};

    fn header(width_px: u32, time_s: Option<f64>) -> Header {
        let f_number = time_s.map(|_| 5.6);
        Header { width_px, height_px: 1000, orientation: 1, time_s, f_number, ..Header::default() }
    }

    /// A view of stripes or of checks, exposed by its time.
    fn seen(header: &Header, view: usize) -> Seen {
        let exposure = header.time_s.unwrap_or(0.1) as f32 * 3.0;
        let codes = Image::from_fn(96, 72, |x, y| {
            let stripes =
                [x / 3 % 8, y / 5 % 7 + 1, (x / 4 + y / 3) % 9, (x / 7 * 5 + y / 6 * 3) % 11][view % 4];
            Code([((1 + stripes) as f32 * 0.1 * exposure).powf(0.45).min(1.0); 3])
        });
        Seen { header: header.clone(), thumbnail: Thumbnail::new(&codes), grid: false }
    }

    fn guessed(files: &[(&str, Header)]) -> Vec<(Role, Vec<String>)> {
        guess(&files.iter().map(|(name, h)| (name.to_string(), seen(h, 0))).collect()).into_iter().collect()
    }

    #[test]
    fn two_series_whose_names_tell_nothing_are_parted_by_what_they_show() {
        let times = [0.4, 0.1, 0.025, 0.00625];
        let mut files: BTreeMap<String, Seen> = BTreeMap::new();
        // Taken in turn, the probe's first.
        for (i, time_s) in times.into_iter().enumerate() {
            for view in 0..2 {
                let photograph = seen(&header(1500, Some(time_s)), view);
                files.insert(format!("IMG_{:04}.JPG", 7 * i + view), Seen { grid: view == 0, ..photograph });
            }
        }
        // Grids from elsewhere, and one from the plate's place.
        files.insert("IMG_0050.JPG".into(), Seen { grid: true, ..seen(&header(1500, Some(0.1)), 2) });
        files.insert("IMG_0051.JPG".into(), Seen { grid: true, ..seen(&header(1500, Some(0.1)), 3) });
        files.insert("IMG_0052.JPG".into(), Seen { grid: true, ..seen(&header(1500, Some(0.1)), 1) });
        let found: Vec<_> = guess(&files).into_iter().collect();
        let brackets: &[&str] = &["IMG_0001.JPG", "IMG_0008.JPG", "IMG_0015.JPG", "IMG_0022.JPG"];
        let probe: &[&str] = &["IMG_0000.JPG", "IMG_0007.JPG", "IMG_0014.JPG", "IMG_0021.JPG"];
        let roles = [
            (Role::Plate, &["IMG_0015.JPG"] as &[&str]),
            (Role::Brackets, brackets),
            (Role::PlateWithGrid, &["IMG_0052.JPG"]),
            (Role::Probe, probe),
            (Role::Grid, &["IMG_0050.JPG", "IMG_0051.JPG"]),
        ];
        assert_eq!(found, expected(&roles));
    }

    fn expected(roles: &[(Role, &[&str])]) -> Vec<(Role, Vec<String>)> {
        roles.iter().map(|(role, files)| (*role, files.iter().map(|f| f.to_string()).collect())).collect()
    }

    #[test]
    fn the_empty_scene_beside_a_series_is_the_plate_and_pictures_without_exposure_are_none() {
        let files = [
            ("difference.png", header(1500, None)),
            ("raw0.jpg", header(1500, Some(0.025))),
            ("raw1.jpg", header(1500, Some(0.1))),
            ("raw2.jpg", header(1500, Some(0.025))),
            ("raw3.jpg", header(1500, Some(0.00625))),
            ("crop1.jpg", header(147, Some(0.1))),
        ];
        let probe: &[&str] = &["raw1.jpg", "raw2.jpg", "raw3.jpg"];
        assert_eq!(guessed(&files), expected(&[(Role::Plate, &["raw0.jpg"]), (Role::Probe, probe)]));
    }

    #[test]
    fn a_series_alone_brackets_its_middle() {
        let files = [5, 10, 100, 500].map(|n| (format!("{n}.jpg"), header(640, Some(1.0 / f64::from(n)))));
        let files = files.each_ref().map(|(name, h)| (name.as_str(), h.clone()));
        let brackets: &[&str] = &["5.jpg", "10.jpg", "100.jpg", "500.jpg"];
        assert_eq!(guessed(&files), expected(&[(Role::Plate, &["100.jpg"]), (Role::Brackets, brackets)]));
    }

    #[test]
    fn photographs_of_other_days_apertures_or_speeds_are_no_series() {
        let alone = expected(&[(Role::Plate, &["a1.jpg"])]);
        let first = Header { date: Some("2008:01:05 10:00:00".into()), ..header(640, Some(0.1)) };
        let later = Header { time_s: Some(0.01), ..first.clone() };
        for other in [
            Header { date: Some("2008:01:06 10:00:01".into()), ..later.clone() },
            Header { f_number: Some(2.8), ..later.clone() },
            Header { iso: Some(800.0), ..later.clone() },
        ] {
            assert_eq!(guessed(&[("a1.jpg", first.clone()), ("a2.jpg", other)]), alone);
        }
        assert_ne!(guessed(&[("a1.jpg", first.clone()), ("a2.jpg", later)]), alone);
    }

    #[test]
    fn without_exposures_the_largest_picture_is_the_plate() {
        let files =
            [("a.png", header(640, None)), ("b.png", header(800, None)), ("c.png", header(800, None))];
        assert_eq!(guessed(&files), expected(&[(Role::Plate, &["b.png"])]));
        assert_eq!(guessed(&[]), expected(&[]));
    }
}
