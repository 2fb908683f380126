// Nothing is cut out by a mask.

fn is_present(instance: u32, triangle: u32, b1: f32, b2: f32) -> bool {
    return true;
}
