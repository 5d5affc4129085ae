//! From headers, roles and settings to a capture, with every check that needs no pixels.

use super::problem::{Problem, role_name};
use super::roles::{Assignment, matching};
use super::{Capture, Exposure, Header, Photo};
use crate::config::{self, Role};
use std::collections::{BTreeMap, BTreeSet};

/// Puts a capture together: exposures from EXIF or the settings, sizes upright. Gives what should be warned of, too.
///
/// A linear file without an exposure is taken to be in the units of the plate. Where only one photograph needs an
/// exposure, none is asked for.
pub fn assemble(
    roles: &Assignment,
    headers: &BTreeMap<String, Header>,
    settings: &config::Ingest,
) -> Result<(Capture, Vec<String>), Problem> {
    let stated = with_overrides(headers, settings)?;
    let mut images = Vec::new();
    for (role, file) in roles {
        let Some((header, upright)) = stated.get(file).map(|h| (h, h.upright_size())) else { continue };
        // The grid's colours do not matter.
        if let Some(profile) = header.profile.as_ref().filter(|_| *role != Role::Grid) {
            return Err(Problem::Profile { file: file.clone(), profile: profile.clone() });
        }
        images.push(Photo {
            file: file.clone(),
            role: *role,
            width_px: upright.0,
            height_px: upright.1,
            exposure: exposure(file, header)?,
            focal_mm: header.focal_mm.or(settings.focal_mm),
            focal_35mm_mm: header.focal_35mm_mm,
            linear: header.linear,
            raw: header.raw,
            camera: header.camera.clone(),
        });
    }
    let mut capture =
        Capture { photos: settings.photos.clone(), images, sensor_width_mm: settings.sensor_width_mm };
    if capture.with_role(Role::Plate).next().is_none() {
        return Err(Problem::NoPlate);
    }
    let mut warnings = Vec::new();
    complete_exposures(&mut capture, &mut warnings)?;
    comparable(&capture, &stated)?;
    for role in [Role::Brackets, Role::Probe] {
        check_series(&capture, role, &stated, &mut warnings)?;
    }
    check_plate(&capture, &mut warnings)?;
    Ok((capture, warnings))
}

fn with_overrides(
    headers: &BTreeMap<String, Header>,
    settings: &config::Ingest,
) -> Result<BTreeMap<String, Header>, Problem> {
    let names: Vec<String> = headers.keys().cloned().collect();
    let mut stated = headers.clone();
    for given in &settings.exposure {
        for file in matching(&given.file, &names, "ingest.exposure")? {
            let Some(header) = stated.get_mut(&file) else { continue };
            header.time_s = given.time_s.or(header.time_s);
            header.f_number = given.f_number.or(header.f_number);
            header.iso = given.iso.or(header.iso);
        }
    }
    Ok(stated)
}

fn exposure(file: &str, header: &Header) -> Result<Option<Exposure>, Problem> {
    let Some(time_s) = header.time_s else { return Ok(None) };
    let (f_number, iso) = (header.f_number.unwrap_or(1.0), header.iso.unwrap_or(100.0));
    let parts = [("an exposure time (s) of", time_s), ("an f-number of", f_number), ("an ISO speed of", iso)];
    for (what, value) in parts {
        if !(value.is_finite() && value > 0.0) {
            return Err(Problem::BadExposure { file: file.into(), what, value });
        }
    }
    Ok(Some(Exposure { time_s, f_number, iso }))
}

/// Finds what may be left out, and refuses what may not.
fn complete_exposures(capture: &mut Capture, warnings: &mut Vec<String>) -> Result<(), Problem> {
    let needing = |photo: &&Photo| match photo.role {
        Role::Plate | Role::Brackets | Role::Probe => !photo.linear,
        _ => false,
    };
    let plate = capture.with_role(Role::Plate).next().map(|p| p.file.clone());
    let of_use = |photo: &&Photo| photo.role != Role::Plate || Some(&photo.file) == plate.as_ref();
    let asked: Vec<&Photo> = capture.images.iter().filter(needing).filter(of_use).collect();
    let files: BTreeSet<&str> = asked.iter().map(|p| p.file.as_str()).collect();
    let series = |role| asked.iter().filter(|p| p.role == role).count() > 1;
    let any_known = asked.iter().any(|p| p.exposure.is_some());
    let unknown = asked.iter().find(|p| p.exposure.is_none());
    if let Some(photo) = unknown {
        if files.len() > 1 && (any_known || series(Role::Brackets) || series(Role::Probe)) {
            return Err(Problem::NoExposure { file: photo.file.clone(), role: photo.role });
        }
        if files.len() > 1 {
            warnings.push(format!(
                "{} state no exposure: they are taken as exposed alike",
                files.into_iter().collect::<Vec<_>>().join(", ")
            ));
        }
    }
    let unit = capture.with_role(Role::Plate).next().and_then(|p| p.exposure);
    for photo in capture.images.iter_mut().filter(|p| p.linear && p.exposure.is_none()) {
        photo.exposure = unit;
        if photo.role == Role::Probe {
            warnings
                .push(format!("{} states no exposure: it is taken to be in units of the plate", photo.file));
        }
    }
    Ok(())
}

/// Aperture and speed must be known of all exposures or of none, and one curve must serve all.
fn comparable(capture: &Capture, headers: &BTreeMap<String, Header>) -> Result<(), Problem> {
    let lit = |p: &&Photo| matches!(p.role, Role::Plate | Role::Brackets | Role::Probe);
    let coded = |p: &&Photo| p.role == Role::Flat || lit(p);
    let timed = |p: &Photo| Some((headers.get(&p.file).filter(|h| h.time_s.is_some())?, p.file.clone()));
    let known: Vec<(&Header, String)> = capture.images.iter().filter(lit).filter_map(timed).collect();
    // A RAW file has the sRGB curve, a JPEG of the same camera one of its own.
    let coded: Vec<&Photo> = capture.images.iter().filter(coded).filter(|p| !p.linear).collect();
    if let (Some(raw), Some(other)) = (coded.iter().find(|p| p.raw), coded.iter().find(|p| !p.raw)) {
        return Err(Problem::MixedRaw { raw: raw.file.clone(), other: other.file.clone() });
    }
    let parts: [(_, Number); 2] = [("an f-number", |h| h.f_number), ("an ISO speed", |h| h.iso)];
    for (what, has) in parts {
        let with = known.iter().find(|(h, _)| has(h).is_some());
        let without = known.iter().find(|(h, _)| has(h).is_none());
        if let (Some((_, with)), Some((_, without))) = (with, without) {
            return Err(Problem::Mixed { what, with: with.clone(), without: without.clone() });
        }
    }
    Ok(())
}

/// A quantity of a header.
type Number = fn(&Header) -> Option<f64>;

fn check_series(
    capture: &Capture,
    role: Role,
    headers: &BTreeMap<String, Header>,
    warnings: &mut Vec<String>,
) -> Result<(), Problem> {
    let series: Vec<&Photo> = capture.with_role(role).collect();
    let Some((first, rest)) = series.split_first() else { return Ok(()) };
    for other in rest {
        same_size(role, first, other)?;
        if other.camera != first.camera {
            warnings.push(format!(
                "{} and {} ({}) come from different cameras",
                first.file,
                other.file,
                role_name(role)
            ));
        }
    }
    for (i, a) in series.iter().enumerate() {
        let equal = |b: &&&Photo| {
            a.exposure.is_some() && (b.exposure.map(|e| e.scale()) == a.exposure.map(|e| e.scale()))
        };
        if let Some(b) = series[..i].iter().find(equal) {
            warnings.push(format!(
                "{} and {} ({}) have equal exposures: they are averaged",
                b.file,
                a.file,
                role_name(role)
            ));
        }
    }
    let parts: [(_, _, Number); 2] = [
        ("aperture", "vignetting and depth of field change with it", |h| h.f_number),
        ("ISO speed", "noise changes with it", |h| h.iso),
    ];
    for (what, consequence, get) in parts {
        let values = series.iter().filter_map(|p| headers.get(&p.file).and_then(get));
        let (low, high) = values.fold((f64::MAX, 0.0_f64), |(l, h), v| (l.min(v), h.max(v)));
        if high > low {
            warnings.push(format!(
                "{what} varies from {low} to {high} within `{}`: {consequence}",
                role_name(role)
            ));
        }
    }
    Ok(())
}

/// Whatever is put over the plate pixel by pixel must have its size.
fn check_plate(capture: &Capture, warnings: &mut Vec<String>) -> Result<(), Problem> {
    let Some(plate) = capture.with_role(Role::Plate).next() else { return Err(Problem::NoPlate) };
    for role in [Role::Brackets, Role::PlateWithGrid, Role::Flat] {
        capture.with_role(role).try_for_each(|other| same_size(role, plate, other))?;
    }
    let more = capture.with_role(Role::Plate).count() - 1;
    if more > 0 {
        warnings.push(format!(
            "{} is augmented; {more} more with the role `plate` tell of the scene alone, by marks",
            plate.file
        ));
    }
    Ok(())
}

fn same_size(role: Role, a: &Photo, b: &Photo) -> Result<(), Problem> {
    let (size, other_size) = ((a.width_px, a.height_px), (b.width_px, b.height_px));
    if size == other_size {
        return Ok(());
    }
    Err(Problem::SizesDiffer { role, file: a.file.clone(), size, other: b.file.clone(), other_size })
}

#[cfg(test)]
mod tests;
