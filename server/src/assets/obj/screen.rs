//! OBJ and MTL text, made safe for `tobj`, which panics on colours of fewer than three numbers and on far
//! relative indices, and takes polylines for faces. Counts are bounded before it builds anything.

use std::{borrow::Cow, collections::HashSet};

use lumicast_engine::scene::SceneLimits;

use crate::assets::error::{AssetError, Bound, bad};

/// OBJ text that `tobj` can read.
#[derive(Debug, Default)]
pub(super) struct Screened {
    pub(super) text: String,
    pub(super) warnings: Vec<String>,
    /// Names of materials that faces ask for, each once, in order.
    pub(super) materials_used: Vec<String>,
}

/// How many positions, texture coordinates and normals stand above a line.
#[derive(Clone, Copy, Debug, Default)]
struct Above([u64; 3]);

/// Checks counts and indices, and leaves out points and lines.
pub(super) fn object_lines(bytes: &[u8], limits: &SceneLimits) -> Result<Screened, AssetError> {
    // Names and comments in some older encoding are no reason to refuse geometry.
    let text = String::from_utf8_lossy(bytes);
    let mut screened = Screened { text: String::with_capacity(text.len()), ..Screened::default() };
    let vertices = Bound { what: "vertices", limit: limits.vertices_max, setting: "scene_vertices" };
    let triangles = Bound { what: "triangles", limit: limits.triangles_max, setting: "scene_triangles" };
    let (mut above, mut triangle_count, mut line_count) = (Above::default(), 0, 0);
    let mut seen = HashSet::new();
    for (index, line) in joined(&text).enumerate() {
        let mut words = line.split_whitespace();
        match words.next() {
            Some("v") => above.0[0] += 1,
            Some("vt") => above.0[1] += 1,
            Some("vn") => above.0[2] += 1,
            Some("l" | "p") => {
                line_count += 1;
                continue;
            }
            Some("f") => {
                let corner_count = words
                    .try_fold(0u64, |count, word| check_corner(word, above, index).map(|()| count + 1))?;
                triangle_count += corner_count.saturating_sub(2);
                triangles.check("OBJ", triangle_count)?;
            }
            Some("usemtl") => {
                let name = line.trim_start().split_once(' ').map_or("", |(_, name)| name.trim());
                if !seen.contains(name) {
                    seen.insert(name.to_string());
                    screened.materials_used.push(name.into());
                }
            }
            _ => {}
        }
        vertices.check("OBJ", above.0[0].max(above.0[1]).max(above.0[2]))?;
        screened.text.push_str(&line);
        screened.text.push('\n');
    }
    if line_count > 0 {
        screened
            .warnings
            .push(format!("{line_count} points and lines are left out: only faces have a surface"));
    }
    Ok(screened)
}

/// `1`, `1/2`, `1//3`, `1/2/3`; negative numbers count back from the line.
fn check_corner(word: &str, above: Above, line_index: usize) -> Result<(), AssetError> {
    for (part, above) in word.split('/').zip(above.0) {
        let Ok(number) = part.parse::<i64>() else { continue };
        let reachable =
            if number < 0 { number.unsigned_abs() <= above } else { number <= i64::from(u32::MAX) };
        if !reachable {
            let problem =
                format!("{word:?} on line {} counts back beyond the first, or too far", line_index + 1);
            return Err(bad("OBJ", "f", problem));
        }
    }
    Ok(())
}

/// Lines with those that end in a backslash joined to the next.
fn joined(text: &str) -> impl Iterator<Item = Cow<'_, str>> {
    let mut lines = text.lines();
    std::iter::from_fn(move || {
        let first = lines.next()?;
        let Some(begin) = first.strip_suffix('\\') else { return Some(Cow::Borrowed(first)) };
        let mut whole = String::from(begin);
        for next in lines.by_ref() {
            whole.push(' ');
            match next.strip_suffix('\\') {
                Some(part) => whole.push_str(part),
                None => {
                    whole.push_str(next);
                    break;
                }
            }
        }
        Some(Cow::Owned(whole))
    })
}

/// MTL text in which every colour has three numbers: one number stands for all three [MTL specification].
pub(super) fn material_lines(bytes: &[u8]) -> String {
    let text = String::from_utf8_lossy(bytes);
    let mut screened = String::with_capacity(text.len());
    for line in text.lines() {
        let words: Vec<&str> = line.split_whitespace().take(4).collect();
        match words[..] {
            ["Ka" | "Kd" | "Ks" | "Ke"] => continue,
            [key @ ("Ka" | "Kd" | "Ks" | "Ke"), red] => {
                screened.push_str(&format!("{key} {red} {red} {red}"))
            }
            [key @ ("Ka" | "Kd" | "Ks" | "Ke"), red, green] => {
                screened.push_str(&format!("{key} {red} {green} {green}"))
            }
            _ => screened.push_str(line),
        }
        screened.push('\n');
    }
    screened
}
