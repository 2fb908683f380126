//! Questions asked of the whole scene: the nearest surface, any surface, the nearest for many rays.

use fearless_simd::{Simd, SimdBase, f32x8};
use glam::Vec3;

use super::{
    Accel, Hit, Ray,
    bundle::{Bundle, RAYS},
    instructions::vectorized,
    leaf::Shear,
    node::{LEAF, Slab, inverse_of},
    stack::{Entry, Stack},
};

impl Accel {
    /// The nearest surface along `ray` that `accept` lets count.
    ///
    /// Of surfaces at the same distance the one with the smallest (instance, triangle) wins, so that the
    /// answer does not depend on the tree's shape.
    pub fn closest_hit(&self, ray: &Ray, accept: impl Fn(&Hit) -> bool) -> Option<Hit> {
        let mut closest = Hit::NONE;
        self.visit::<true>(ray, |hit, t_max| {
            if hit.is_before(&closest) && accept(&hit) {
                *t_max = hit.t;
                closest = hit;
            }
            false
        });
        closest.some()
    }

    /// True when any surface that `accept` lets count lies on `ray`.
    pub fn is_occluded(&self, ray: &Ray, accept: impl Fn(&Hit) -> bool) -> bool {
        self.visit::<false>(ray, |hit, _| accept(&hit))
    }

    /// [`Accel::closest_hit`] of every ray, with the same answers, in the same order.
    ///
    /// Every eight rays that follow each other and go the same way are walked as one, which takes less than half the time for
    /// neighbouring pixels; others are walked alone. Missing hits are `None`; `hits` is as long as `rays`, or the shorter
    /// of both counts.
    pub fn closest_hits(&self, rays: &[Ray], hits: &mut [Option<Hit>], accept: impl Fn(&Hit) -> bool) {
        let (eights, rest) = rays.as_chunks::<RAYS>();
        let (hits_of_eights, hits_of_rest) = hits.split_at_mut(hits.len().min(eights.len() * RAYS));
        for (eight, hits) in eights.iter().zip(hits_of_eights.chunks_mut(RAYS)) {
            match vectorized!(self.level, simd => self.closest_of(simd, eight, &accept)) {
                Some(closest) => {
                    for (hit, closest) in hits.iter_mut().zip(closest) {
                        *hit = closest.some();
                    }
                }
                None => {
                    for (hit, ray) in hits.iter_mut().zip(eight) {
                        *hit = self.closest_hit(ray, &accept);
                    }
                }
            }
        }
        for (hit, ray) in hits_of_rest.iter_mut().zip(rest) {
            *hit = self.closest_hit(ray, &accept);
        }
    }

    /// Calls `found` with every triangle hit up to `t_max`; `found` may lower it, and ends the walk by true.
    #[inline(always)]
    fn visit<const NEAREST_FIRST: bool>(&self, ray: &Ray, found: impl FnMut(Hit, &mut f32) -> bool) -> bool {
        vectorized!(self.level, simd => self.visit_with::<_, NEAREST_FIRST>(simd, ray, found))
    }

    #[inline(always)]
    fn visit_with<S: Simd, const NEAREST_FIRST: bool>(
        &self,
        simd: S,
        ray: &Ray,
        mut found: impl FnMut(Hit, &mut f32) -> bool,
    ) -> bool {
        let top = self.top.tree();
        let mut stack = Stack::of_thread(top.tree().stack_need() + self.bottom_stack_need);
        let entries = stack.entries();
        let inverse_in_render = inverse_of(ray.direction);
        // A walk that starts at a part enters no node of the top tree.
        let slab_in_render = if top.start() & LEAF == 0 {
            Slab::new(ray.origin, inverse_in_render, top.tree().bounds())
                .widened(self.room_for_transforms(ray.origin))
        } else {
            Slab::NONE
        };
        // Parts of one instance often come one after the other: the ray goes into its space once.
        let mut entered = u32::MAX;
        let (mut local, mut inverse, mut shear) = (*ray, inverse_in_render, Shear::NONE);
        let (mut slab, mut has_slab) = (Slab::NONE, false);
        // A negative one, also in place of NaN, lets nothing be entered.
        let mut t_max = ray.t_max.max(-1.0);
        top.tree().walk::<S, NEAREST_FIRST>(
            simd,
            top.start(),
            &slab_in_render,
            &mut t_max,
            entries,
            #[inline(always)]
            |part: u32, t_max: &mut f32, stack: &mut [Entry]| {
                let part = top.part(part);
                let instance = &*self.instances[part.instance as usize];
                let bottom = instance.bottom();
                if part.instance != entered {
                    entered = part.instance;
                    local = instance.ray_in_mesh(ray);
                    inverse = if instance.is_only_moved() {
                        inverse_in_render
                    } else {
                        inverse_of(local.direction)
                    };
                    shear = Shear::new(&local, inverse).within(part.instance, ray);
                    has_slab = false;
                }
                // Most parts are leaves, which have no boxes to test.
                if part.child & LEAF == 0 && !has_slab {
                    slab = Slab::new(local.origin, inverse, bottom.tree().bounds());
                    has_slab = true;
                }
                bottom.visit::<S, NEAREST_FIRST>(
                    simd,
                    part.child,
                    (&slab, &shear),
                    t_max,
                    stack,
                    #[inline(always)]
                    |met, t_max| found(Hit::new(part.instance, &met), t_max),
                )
            },
        )
    }

    /// The nearest surface along each of eight rays; `None` for rays that make no bundle.
    #[inline(always)]
    fn closest_of<S: Simd>(
        &self,
        simd: S,
        rays: &[Ray; RAYS],
        accept: &impl Fn(&Hit) -> bool,
    ) -> Option<[Hit; RAYS]> {
        let top = self.top.tree();
        let farthest_origin = rays.iter().fold(Vec3::ZERO, |a, ray| a.max(ray.origin.abs()));
        let bundle = Bundle::new(simd, rays, top.tree().bounds())?;
        let slab_in_render = bundle.slab().widened(self.room_for_transforms(farthest_origin));
        let mut stack = Stack::of_thread(top.tree().stack_need() + self.bottom_stack_need);
        let entries = stack.entries();
        let mut closest = [Hit::NONE; RAYS];
        let mut t_max = rays.map(|ray| ray.t_max);
        let mut entered = u32::MAX;
        // `None` where the bundle falls apart in the instance's space.
        let mut local: Option<Bundle> = None;
        let mut farthest = largest(simd, &t_max);
        top.tree().walk::<S, true>(
            simd,
            top.start(),
            &slab_in_render,
            &mut farthest,
            entries,
            #[inline(always)]
            |part: u32, farthest: &mut f32, stack: &mut [Entry]| {
                let part = top.part(part);
                let instance = &*self.instances[part.instance as usize];
                let bottom = instance.bottom();
                if part.instance != entered {
                    entered = part.instance;
                    local = if instance.is_only_moved() {
                        Some(bundle.seen_from(simd, instance.centre_in_render()))
                    } else {
                        let turned = rays.map(|ray| instance.ray_in_mesh(&ray));
                        Bundle::new(simd, &turned, bottom.tree().bounds())
                    };
                }
                let mut found = |ray: usize, hit: Hit, t_max: &mut f32| {
                    let is_left = hit.triangle_id() == rays[ray].left;
                    if !is_left && hit.is_before(&closest[ray]) && accept(&hit) {
                        *t_max = hit.t;
                        closest[ray] = hit;
                    }
                };
                match &local {
                    Some(local) => {
                        let leaves = bottom.leaves();
                        bottom.tree().walk::<S, true>(
                            simd,
                            part.child,
                            local.slab(),
                            farthest,
                            stack,
                            #[inline(always)]
                            |leaf, farthest, _| {
                                local.intersect(
                                    simd,
                                    &leaves.packet(leaf),
                                    &mut t_max,
                                    #[inline(always)]
                                    |ray, met, t_max| {
                                        found(ray, Hit::new(part.instance, &met), t_max);
                                    },
                                );
                                *farthest = largest(simd, &t_max);
                                false
                            },
                        );
                    }
                    None => {
                        for ray in 0..RAYS {
                            let local = instance.ray_in_mesh(&rays[ray]);
                            let inverse = inverse_of(local.direction);
                            let slab = Slab::new(local.origin, inverse, bottom.tree().bounds());
                            let shear = Shear::new(&local, inverse).within(part.instance, &rays[ray]);
                            bottom.visit::<S, true>(
                                simd,
                                part.child,
                                (&slab, &shear),
                                &mut t_max[ray],
                                stack,
                                #[inline(always)]
                                |met, t_max| {
                                    found(ray, Hit::new(part.instance, &met), t_max);
                                    false
                                },
                            );
                        }
                        *farthest = largest(simd, &t_max);
                    }
                }
                false
            },
        );
        Some(closest)
    }

    /// What the way of a ray from `origin` into the space of the most sheared instance may round by, beyond what boxes
    /// leave room for anyway.
    #[inline(always)]
    fn room_for_transforms(&self, origin: Vec3) -> f32 {
        self.shear_rounding * origin.abs().max_element()
    }
}

/// The largest of eight numbers, none of them NaN.
#[inline(always)]
fn largest<S: Simd>(simd: S, numbers: &[f32; RAYS]) -> f32 {
    f32x8::load_array_ref(simd, numbers).reduce_max()
}
