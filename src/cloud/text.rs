//! Points as lines of text: XYZ, OBJ, and the ASCII forms of PLY and PCD.

use glam::DVec3;

/// Lines before the first point that may hold no point: a title, column names, a count.
const HEADER_LINES: usize = 2;

/// The lines of `bytes` with their numbers from 1, blank ends cut off. Bytes that are no text
/// stay in as they are: what is made of them is no number.
fn lines(bytes: &[u8]) -> impl Iterator<Item = (usize, &[u8])> {
    let lines = bytes.split(|b| *b == b'\n').enumerate();
    lines.map(|(i, line)| (i + 1, line.trim_ascii()))
}

/// The words of a line, parted by blanks, commas or semicolons.
fn words(line: &[u8]) -> impl Iterator<Item = &[u8]> {
    line.split(|b| b.is_ascii_whitespace() || *b == b',' || *b == b';')
        .filter(|word| !word.is_empty())
}

fn number(word: &[u8]) -> Option<f64> {
    std::str::from_utf8(word).ok()?.parse().ok()
}

fn three<'a>(mut words: impl Iterator<Item = &'a [u8]>) -> Option<DVec3> {
    let mut next = || number(words.next()?);
    Some(DVec3::new(next()?, next()?, next()?))
}

fn no_point(line: usize, text: &[u8]) -> String {
    let shown: String = String::from_utf8_lossy(text).chars().take(40).collect();
    format!("line {line} holds no three numbers: {shown:?}")
}

/// A point a line, its first three numbers. Comments and up to two leading lines are passed over.
pub fn read_xyz(bytes: &[u8]) -> Result<Vec<DVec3>, String> {
    let mut positions = Vec::new();
    let mut header = 0;
    for (number, line) in lines(bytes) {
        if line.is_empty() || line.starts_with(b"#") || line.starts_with(b"//") {
            continue;
        }
        match three(words(line)) {
            Some(position) => positions.push(position),
            None if positions.is_empty() && header < HEADER_LINES => header += 1,
            None => return Err(no_point(number, line)),
        }
    }
    if positions.is_empty() && header > 0 {
        return Err("none of its lines holds three numbers".to_owned());
    }
    Ok(positions)
}

/// The `v` lines of a Wavefront file.
pub fn read_obj(bytes: &[u8]) -> Result<Vec<DVec3>, String> {
    let mut positions = Vec::new();
    for (number, line) in lines(bytes) {
        let Some(rest) = line.strip_prefix(b"v") else {
            continue;
        };
        // vn, vt and vp are others
        if rest.first().is_some_and(u8::is_ascii_whitespace) {
            positions.push(three(words(rest)).ok_or_else(|| no_point(number, line))?);
        }
    }
    Ok(positions)
}

/// `count` lines with x, y and z in the given columns (from 0).
pub fn columns(bytes: &[u8], axes: [usize; 3], count: u64) -> Result<Vec<DVec3>, String> {
    // a point takes at least five characters and an end of line
    let most = (bytes.len() / 6 + 1) as u64;
    let mut positions = Vec::with_capacity(count.min(most) as usize);
    let full = |positions: &Vec<DVec3>| positions.len() as u64 >= count;
    for (_, line) in lines(bytes) {
        if full(&positions) {
            break;
        }
        if line.is_empty() {
            continue;
        }
        let mut point = [None; 3];
        let last = axes.iter().copied().max().unwrap_or(0);
        for (column, word) in words(line).enumerate().take(last + 1) {
            for (value, &axis) in point.iter_mut().zip(&axes) {
                if axis == column {
                    *value = number(word);
                }
            }
        }
        let [Some(x), Some(y), Some(z)] = point else {
            return Err(format!(
                "point {} is no numbers: {:?}",
                positions.len(),
                String::from_utf8_lossy(line)
                    .chars()
                    .take(40)
                    .collect::<String>()
            ));
        };
        positions.push(DVec3::new(x, y, z));
    }
    if !full(&positions) {
        return Err(format!(
            "{count} points are announced and {} follow",
            positions.len()
        ));
    }
    Ok(positions)
}

/// What follows `count` lines that are not blank; `None` where there are fewer.
pub fn after_lines(bytes: &[u8], count: usize) -> Option<&[u8]> {
    let mut rest = bytes;
    let mut left = count;
    while left > 0 {
        if rest.is_empty() {
            return None;
        }
        let end = rest.iter().position(|b| *b == b'\n');
        let (line, after) = match end {
            Some(end) => (&rest[..end], &rest[end + 1..]),
            None => (rest, &rest[rest.len()..]),
        };
        left -= usize::from(!line.trim_ascii().is_empty());
        rest = after;
    }
    Some(rest)
}
