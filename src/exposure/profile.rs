//! Embedded colour profiles (ICC.1:2022): told by their primaries.

/// XYZ (D50) of red, green and blue of sRGB, whose primaries are those of Rec. 709.
const SRGB: [[f64; 3]; 3] = [[0.4361, 0.2225, 0.0139], [0.3851, 0.7169, 0.0971], [0.1431, 0.0606, 0.7141]];
/// Some others by their red.
const KNOWN: [(&str, [f64; 3]); 3] = [
    ("Adobe RGB", [0.6097, 0.3111, 0.0195]),
    ("Display P3", [0.5151, 0.2412, -0.0011]),
    ("ProPhoto RGB", [0.7977, 0.2880, 0.0000]),
];
/// How far profiles of the same name are apart.
const ALIKE: f64 = 0.01;

/// What profile it is, where its primaries are not those of sRGB; `None` for those and for grey.
pub(super) fn foreign(icc: &[u8]) -> Option<String> {
    if icc.get(16..20) == Some(b"GRAY") {
        return None;
    }
    let Some(primaries) = primaries(icc) else { return Some("a profile without primaries".into()) };
    let alike = |a: &[f64; 3], b: &[f64; 3]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < ALIKE);
    if primaries.iter().zip(&SRGB).all(|(a, b)| alike(a, b)) {
        return None;
    }
    let known = KNOWN.iter().find(|(_, red)| alike(red, &primaries[0]));
    Some(known.map_or("a profile of other primaries than sRGB".into(), |(name, _)| (*name).into()))
}

/// The tags rXYZ, gXYZ, bXYZ.
fn primaries(icc: &[u8]) -> Option<[[f64; 3]; 3]> {
    let word = |at: usize| Some(u32::from_be_bytes(icc.get(at..at + 4)?.try_into().ok()?));
    let tag = |name: &[u8; 4]| {
        let entry = (0..word(128)?.min(200) as usize)
            .map(|i| 132 + 12 * i)
            .find(|at| icc.get(*at..at + 4) == Some(name))?;
        let at = word(entry + 4)? as usize + 8;
        let number = |i: usize| Some(f64::from(word(at + 4 * i)?.cast_signed()) / 65536.0);
        Some([number(0)?, number(1)?, number(2)?])
    };
    Some([tag(b"rXYZ")?, tag(b"gXYZ")?, tag(b"bXYZ")?])
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// A profile with nothing but primaries.
    pub fn profile(primaries: &[[f64; 3]; 3]) -> Vec<u8> {
        let mut icc = vec![0; 128];
        icc[16..20].copy_from_slice(b"RGB ");
        icc.extend(3_u32.to_be_bytes());
        for (i, name) in [b"rXYZ", b"gXYZ", b"bXYZ"].iter().enumerate() {
            icc.extend(*name);
            icc.extend((168 + 20 * i as u32).to_be_bytes());
            icc.extend(20_u32.to_be_bytes());
        }
        for colour in primaries {
            icc.extend(b"XYZ \0\0\0\0");
            colour.iter().for_each(|v| icc.extend(((v * 65536.0) as i32).to_be_bytes()));
        }
        icc
    }

    #[test]
    fn profiles_are_told_by_their_primaries() {
        assert_eq!(foreign(&profile(&SRGB)), None);
        let adobe = [[0.6097, 0.3111, 0.0195], [0.2053, 0.6257, 0.0609], [0.1492, 0.0632, 0.7446]];
        assert_eq!(foreign(&profile(&adobe)).as_deref(), Some("Adobe RGB"));
        let odd = [[0.5, 0.3, 0.0], [0.3, 0.6, 0.1], [0.16, 0.1, 0.7]];
        assert_eq!(foreign(&profile(&odd)).as_deref(), Some("a profile of other primaries than sRGB"));
    }

    #[test]
    fn what_is_cut_short_has_no_primaries() {
        let whole = profile(&SRGB);
        for length in [0, 10, 130, 150, 190] {
            assert_eq!(foreign(&whole[..length]).as_deref(), Some("a profile without primaries"), "{length}");
        }
        let mut grey = vec![0; 128];
        grey[16..20].copy_from_slice(b"GRAY");
        assert_eq!(foreign(&grey), None);
    }
}
