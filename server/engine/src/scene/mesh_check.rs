//! Checks a mesh on its way in: indices, counts, numbers; leaves out triangles without area.

use glam::{DVec3, Vec3};

use super::{Aabb, Id, Mesh, MeshSource, Primitive, SceneError, check::bad};

/// A valid mesh and what was odd about it.
pub(in crate::scene) struct CheckedMesh {
    pub(in crate::scene) mesh: Mesh,
    pub(in crate::scene) warnings: Vec<String>,
}

/// Turns raw numbers into a [`Mesh`].
pub(in crate::scene) fn check(
    id: &Id,
    source: MeshSource,
    coordinate_max_m: f64,
) -> Result<CheckedMesh, SceneError> {
    let vertex_count = source.positions.len();
    check_counts(id, &source)?;
    check_numbers(id, &source, coordinate_max_m)?;
    let outside = |triangle: &[u32; 3]| triangle.iter().any(|vertex| *vertex as usize >= vertex_count);
    if let Some(index) = source.triangles.iter().position(outside) {
        let value = format!("{:?} in triangle {index}", source.triangles[index]);
        return Err(bad("mesh", id, "triangles", value, "below the number of positions"));
    }
    check_runs(id, &source)?;

    let mut warnings = Vec::new();
    // Of what triangles use: one forgotten vertex far away would take the digits of all others.
    let corners = source.triangles.iter().flatten().map(|vertex| source.positions[*vertex as usize]);
    let bounds = corners.fold(Aabb::EMPTY, |bounds, position| bounds.including(position));
    let centre = if bounds.is_empty() { DVec3::ZERO } else { bounds.centre() };
    let positions: Vec<Vec3> =
        source.positions.iter().map(|position| (position - centre).as_vec3()).collect();
    let normals = unit_normals(source.normals);
    let (triangles, primitives) =
        without_degenerate(&positions, &source.triangles, source.primitives, &mut warnings);
    if triangles.is_empty() {
        warnings.push("has no triangle with area and shows nothing".into());
    }
    let mesh = Mesh {
        centre,
        positions,
        normals,
        tangents: source.tangents,
        texcoords: source.texcoords,
        colors: source.colors,
        triangles,
        primitives,
        bounds,
    };
    Ok(CheckedMesh { mesh, warnings })
}

fn check_counts(id: &Id, source: &MeshSource) -> Result<(), SceneError> {
    let counts = [
        ("normals", source.normals.len()),
        ("tangents", source.tangents.len()),
        ("texcoords", source.texcoords[0].len()),
        ("texcoords", source.texcoords[1].len()),
        ("colors", source.colors.len()),
    ];
    for (field, count) in counts {
        if count != 0 && count != source.positions.len() {
            let value = format!("{count} for {} positions", source.positions.len());
            return Err(bad("mesh", id, field, value, "as many as positions, or none"));
        }
    }
    Ok(())
}

fn check_numbers(id: &Id, source: &MeshSource, coordinate_max_m: f64) -> Result<(), SceneError> {
    let refuse = |field, index: usize, value: String, expected| {
        Err(bad("mesh", id, field, format!("{value} at vertex {index}"), expected))
    };
    // `max_element` passes over NaN in all but its last place, so finiteness is asked for by itself.
    let far = |position: &DVec3| !(position.is_finite() && position.abs().max_element() <= coordinate_max_m);
    if let Some(index) = source.positions.iter().position(far) {
        return refuse(
            "positions",
            index,
            source.positions[index].to_string(),
            "finite and within the coordinate limit",
        );
    }
    if let Some(index) = source.normals.iter().position(|normal| !normal.is_finite()) {
        return refuse("normals", index, source.normals[index].to_string(), "finite");
    }
    if let Some(index) = source.tangents.iter().position(|tangent| !tangent.is_finite()) {
        return refuse("tangents", index, source.tangents[index].to_string(), "finite");
    }
    for texcoords in &source.texcoords {
        if let Some(index) = texcoords.iter().position(|texcoord| !texcoord.is_finite()) {
            return refuse("texcoords", index, texcoords[index].to_string(), "finite");
        }
    }
    let is_factor = |value: f32| (0.0..=1.0).contains(&value);
    if let Some(index) = source.colors.iter().position(|color| !color.to_array().into_iter().all(is_factor)) {
        return refuse("colors", index, source.colors[index].to_string(), "between 0 and 1");
    }
    Ok(())
}

/// Primitives must cover all triangles in order, so that a triangle's material is one binary search away.
fn check_runs(id: &Id, source: &MeshSource) -> Result<(), SceneError> {
    let mut next = 0u64;
    for primitive in &source.primitives {
        if u64::from(primitive.first_triangle) != next {
            let value = format!("a run from {} after {next}", primitive.first_triangle);
            return Err(bad("mesh", id, "primitives", value, "runs that follow each other"));
        }
        next += u64::from(primitive.triangle_count);
    }
    if next != source.triangles.len() as u64 {
        let value = format!("runs of {next} triangles for {}", source.triangles.len());
        return Err(bad("mesh", id, "primitives", value, "runs that cover all triangles"));
    }
    Ok(())
}

/// Zero vectors stay: they ask for the triangle's own normal. Double precision holds the length of any other.
fn unit_normals(normals: Vec<Vec3>) -> Vec<Vec3> {
    normals.into_iter().map(|normal| normal.as_dvec3().normalize_or_zero().as_vec3()).collect()
}

fn without_degenerate(
    positions: &[Vec3],
    triangles: &[[u32; 3]],
    primitives: Vec<Primitive>,
    warnings: &mut Vec<String>,
) -> (Vec<[u32; 3]>, Vec<Primitive>) {
    let has_area = |triangle: &[u32; 3]| {
        let [a, b, c] = triangle.map(|vertex| positions[vertex as usize].as_dvec3());
        (b - a).cross(c - a).length_squared() > 0.0
    };
    let mut kept = Vec::with_capacity(triangles.len());
    let mut runs = Vec::with_capacity(primitives.len());
    for primitive in primitives {
        let first = kept.len();
        let run =
            primitive.first_triangle as usize..(primitive.first_triangle + primitive.triangle_count) as usize;
        kept.extend(triangles[run].iter().filter(|triangle| has_area(triangle)));
        let triangle_count = (kept.len() - first) as u32;
        if triangle_count > 0 {
            runs.push(Primitive { first_triangle: first as u32, triangle_count, ..primitive });
        }
    }
    let left_out = triangles.len() - kept.len();
    if left_out > 0 {
        warnings.push(format!("{left_out} of {} triangles have no area and were left out", triangles.len()));
    }
    (kept, runs)
}
