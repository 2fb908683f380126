// How much the steps to come have to do.

struct Dispatch {
    rays_x: u32,
    rays_y: u32,
    rays_z: u32,
    shadow_rays_x: u32,
    shadow_rays_y: u32,
    shadow_rays_z: u32,
    padding_0: u32,
    padding_1: u32,
}

@group(3) @binding(0) var<storage, read_write> dispatch: Dispatch;

fn workgroups_for(count: u32) -> u32 {
    return (count + WORKGROUP - 1u) / WORKGROUP;
}
