//! Roles of photographs whose names tell none, from sizes and exposures.

use crate::config::Role;
use crate::exposure::Header;
use std::collections::BTreeMap;

/// Of the largest photographs, the longest run of rising or falling exposures is a series. Beside it there is the empty
/// scene, and the series shows the ball; or else its middle is the plate.
pub fn roles(headers: &BTreeMap<String, Header>) -> BTreeMap<Role, Vec<String>> {
    // Masks, drawings and finished pictures state no exposure; photographs do.
    let stated = headers.values().any(|h| h.time_s.is_some());
    let photographs = || headers.iter().filter(|(_, h)| !stated || h.time_s.is_some());
    let area = |h: &Header| u64::from(h.width_px) * u64::from(h.height_px);
    let largest = photographs().map(|(_, h)| area(h)).max().unwrap_or(0);
    let size = photographs().find(|(_, h)| area(h) == largest).map(|(_, h)| h.upright_size());
    let mut files: Vec<(&String, &Header)> =
        photographs().filter(|(_, h)| Some(h.upright_size()) == size).collect();
    files.sort_by_cached_key(|(name, _)| by_number(name));
    let names =
        |range: std::ops::Range<usize>| files[range].iter().map(|(n, _)| n.to_string()).collect::<Vec<_>>();
    let mut series = 0..0;
    for rising in [true, false] {
        let mut start = 0;
        for i in 1..=files.len() {
            let on = i < files.len() && steps(files[i - 1].1, files[i].1, rising);
            if !on {
                if i - start >= 2 && i - start > series.len() {
                    series = start..i;
                }
                start = i;
            }
        }
    }
    let beside = (0..files.len()).find(|i| !series.contains(i));
    let plate = beside.unwrap_or(series.start + series.len() / 2);
    let mut roles = BTreeMap::new();
    if plate < files.len() {
        roles.insert(Role::Plate, names(plate..plate + 1));
    }
    if !series.is_empty() {
        roles.insert(if beside.is_some() { Role::Probe } else { Role::Brackets }, names(series));
    }
    roles
}

/// Whether only the exposure time rises (or falls) from one photograph to the next, on the same day.
fn steps(a: &Header, b: &Header, rising: bool) -> bool {
    let setting = |h: &Header| (h.camera.clone(), h.focal_mm, h.f_number, h.iso);
    let day = |h: &Header| h.date.as_ref().and_then(|d| d.get(..10).map(String::from));
    let same_day = day(a).zip(day(b)).is_none_or(|(a, b)| a == b);
    let stepped = a.time_s.zip(b.time_s).is_some_and(|(a, b)| if rising { b > a } else { b < a });
    stepped && same_day && setting(a) == setting(b)
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

    fn header(width_px: u32, time_s: Option<f64>) -> Header {
        let f_number = time_s.map(|_| 5.6);
        Header { width_px, height_px: 1000, orientation: 1, time_s, f_number, ..Header::default() }
    }

    fn guessed(files: &[(&str, Header)]) -> Vec<(Role, Vec<String>)> {
        roles(&files.iter().map(|(name, h)| (name.to_string(), h.clone())).collect()).into_iter().collect()
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
