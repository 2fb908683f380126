//! The picture, filling what the panels leave, and the hand on the camera.

use crate::camera::FlyDirection;
use crate::model::tree::light_place;
use crate::model::{Model, Selected};
use crate::panels::scene::draw_sun;
use crate::picture::Canvas;
use crate::theme;
use crate::tone_map::Display;
use egui::{
    Align2, Color32, ColorImage, FontId, Key, PointerButton, Pos2, Rect, Response, Role, Sense,
    TextureHandle, TextureOptions, Ui, Vec2, WidgetInfo, pos2, vec2,
};
use glam::{DVec2, DVec3};
use lumicast_protocol::{Id, ToneMap};

/// A new size is asked for once the window has kept it this long: each one restarts the film.
const RESIZE_PAUSE_S: f64 = 0.15;
/// A drag over the whole height turns by half a circle.
const ORBIT_RAD_PER_HEIGHT: f64 = std::f64::consts::PI;
/// Looking around is slower than orbiting: the whole picture moves.
const LOOK_RAD_PER_HEIGHT: f64 = 1.6;
/// A notch of a wheel is about 50 points: 15 % closer.
const DOLLY_PER_POINT: f64 = 0.003;
/// Flying crosses the scene's radius in two seconds.
const FLY_RADII_PER_SECOND: f64 = 0.5;
const FLY_FAST: f64 = 4.0;
/// A frame that took longer does not throw the camera through a wall.
const FLY_STEP_MAX_S: f64 = 0.1;
/// Lights with a sign in the picture; beyond it the signs hide it.
const SIGNS_MAX: usize = 200;
/// How near a click must be to a sign, in points.
const SIGN_REACH: f32 = 12.0;

/// The viewport's state.
pub struct Viewport {
    canvas: Option<Canvas>,
    texture: Option<TextureHandle>,
    texture_is_stale: bool,
    display: (ToneMap, f32, Display),
    /// The size seen last and since when.
    size: Option<([f64; 2], f64)>,
    /// Places of lights, of this version of the scene.
    lights: (u64, Vec<(Id, DVec3)>),
    /// Whether lights have signs.
    pub show_signs: bool,
}

impl Default for Viewport {
    fn default() -> Self {
        let tone_map = ToneMap::default();
        Self {
            canvas: None,
            texture: None,
            texture_is_stale: false,
            display: (tone_map, 0.0, Display::new(tone_map, 0.0)),
            size: None,
            lights: (0, vec![]),
            show_signs: true,
        }
    }
}

impl Viewport {
    /// Whether there is a picture.
    pub fn has_picture(&self) -> bool {
        self.canvas.is_some()
    }

    /// Takes the canvas to lay something over it; to be given back with [`Viewport::set_canvas`].
    pub fn take_canvas(&mut self) -> Option<Canvas> {
        self.canvas.take()
    }

    /// A new picture.
    pub fn set_canvas(&mut self, canvas: Canvas) {
        self.canvas = Some(canvas);
        self.texture_is_stale = true;
    }

    /// Another scene: its picture is still to come.
    pub fn clear(&mut self) {
        (self.canvas, self.texture) = (None, None);
    }

    /// Draws the picture and moves the camera.
    pub fn show(&mut self, ui: &mut Ui, model: &mut Model, now_s: f64) {
        let rect = ui.available_rect_before_wrap();
        let response = ui.allocate_rect(rect, Sense::click_and_drag());
        response.widget_info(|| WidgetInfo::labeled(Role::Image, true, "picture"));
        ui.painter().rect_filled(rect, 0.0, theme::BACKDROP);
        self.ask_for_size(ui, model, rect, now_s);
        navigate(ui, model, &response);
        self.upload(ui, model);
        match (&self.texture, &self.canvas) {
            (Some(texture), Some(canvas)) => {
                let shape = canvas.full_size().map(|side| side as f32);
                let place = fitted(rect, vec2(shape[0], shape[1]), ui.pixels_per_point());
                let uv = Rect::from_min_max(Pos2::ZERO, pos2(1.0, 1.0));
                ui.painter().image(texture.id(), place, uv, Color32::WHITE);
            }
            _ => self.show_waiting(ui, model, rect),
        }
        self.show_lights(ui, model, &response);
    }

    fn show_waiting(&self, ui: &Ui, model: &Model, rect: Rect) {
        if model.link.is_open() {
            let text = "waiting for the first picture …";
            ui.painter().text(
                rect.center(),
                Align2::CENTER_CENTER,
                text,
                FontId::proportional(14.0),
                theme::WEAK,
            );
        }
    }

    fn ask_for_size(&mut self, ui: &Ui, model: &mut Model, rect: Rect, now_s: f64) {
        let side_max = ui.input(|input| input.max_texture_side) as f64;
        let size = [rect.width(), rect.height()].map(|side| {
            let pixels = f64::from(side) * f64::from(ui.pixels_per_point());
            pixels.round().clamp(1.0, side_max)
        });
        let since_s = match self.size {
            Some((before, since_s)) if before == size => since_s,
            // The first one is asked for at once.
            None => f64::NEG_INFINITY,
            Some(_) => now_s,
        };
        self.size = Some((size, since_s));
        let rest_s = since_s + RESIZE_PAUSE_S - now_s;
        if rest_s <= 0.0 {
            model.set_size(size);
        } else {
            ui.ctx().request_repaint_after(std::time::Duration::from_secs_f64(rest_s));
        }
    }

    /// Brings a new picture, or an old one of radiance under new exposure, to the graphics card.
    fn upload(&mut self, ui: &Ui, model: &mut Model) {
        let Some(canvas) = &self.canvas else { return };
        let quality = model.quality();
        let (tone_map, exposure_ev, _) = &self.display;
        if canvas.is_radiance() && (*tone_map, *exposure_ev) != (quality.tone_map, quality.exposure_ev) {
            let display = Display::new(quality.tone_map, quality.exposure_ev);
            self.display = (quality.tone_map, quality.exposure_ev, display);
            self.texture_is_stale = true;
        }
        if !std::mem::take(&mut self.texture_is_stale) {
            return;
        }
        let side_max = ui.input(|input| input.max_texture_side);
        let [width, height] = canvas.size();
        if width.max(height) > side_max {
            let detail =
                format!("{width} × {height} pixels; this graphics card shows up to {side_max} a side");
            model.tell_error("A picture is too large to show", &detail);
            (self.canvas, self.texture) = (None, None);
            return;
        }
        let image = ColorImage::from_rgb(canvas.size(), &canvas.to_srgb(&self.display.2));
        match &mut self.texture {
            Some(texture) => texture.set(image, TextureOptions::LINEAR),
            None => self.texture = Some(ui.ctx().load_texture("picture", image, TextureOptions::LINEAR)),
        }
    }

    /// A sign where each light is; a click selects it.
    fn show_lights(&mut self, ui: &Ui, model: &mut Model, response: &Response) {
        let (Some(scene), Some(viewpoint)) = (&model.scene, model.viewpoint()) else { return };
        if !self.show_signs || self.canvas.is_none() {
            return;
        }
        if self.lights.0 != scene.version {
            let description = &scene.description;
            let lights = description.lights.iter().take(SIGNS_MAX);
            let places =
                lights.filter_map(|light| Some((light.id.clone(), light_place(description, &light.id)?)));
            self.lights = (scene.version, places.collect());
        }
        let rect = response.rect;
        let aspect = f64::from(rect.width() / rect.height().max(1.0));
        let signs: Vec<(&Id, Pos2)> = self
            .lights
            .1
            .iter()
            .filter_map(|(id, place)| {
                let at = viewpoint.camera.project(*place, aspect)?;
                let at = rect.min + vec2(at.x as f32, at.y as f32) * rect.size();
                rect.contains(at).then_some((id, at))
            })
            .collect();
        let painter = ui.painter().with_clip_rect(rect);
        for (id, at) in &signs {
            let selected = matches!(&model.selected, Some(Selected::Light(light)) if light == *id);
            // A dark disc below: the sign is to be seen on a white wall too.
            painter.circle_filled(*at, 8.0, Color32::from_black_alpha(110));
            draw_sun(
                &painter,
                *at,
                4.0,
                if selected { theme::ACCENT } else { Color32::from_white_alpha(200) },
            );
        }
        let clicked = response.clicked().then(|| response.interact_pointer_pos()).flatten();
        let nearest = clicked.and_then(|pointer| {
            let reach = |(_, at): &&(&Id, Pos2)| at.distance(pointer);
            signs.iter().min_by(|a, b| reach(a).total_cmp(&reach(b))).filter(|sign| reach(sign) < SIGN_REACH)
        });
        if let Some((id, _)) = nearest {
            model.selected = Some(Selected::Light((*id).clone()));
        }
    }
}

/// The largest rectangle of a shape inside another, on whole pixels: a picture of the right size is shown untouched.
fn fitted(rect: Rect, shape: Vec2, pixels_per_point: f32) -> Rect {
    let scale = (rect.width() / shape.x).min(rect.height() / shape.y);
    let size = shape * scale;
    // A window and the picture asked for it differ by less than a pixel: fill it.
    let size = if (rect.size() - size).max_elem() * pixels_per_point < 1.0 { rect.size() } else { size };
    Rect::from_center_size(rect.center(), size)
}

fn navigate(ui: &Ui, model: &mut Model, response: &Response) {
    let height = f64::from(response.rect.height().max(1.0));
    let delta = response.drag_delta();
    let drag = DVec2::new(f64::from(delta.x), f64::from(delta.y)) / height;
    let shift = ui.input(|input| input.modifiers.shift);
    let pans =
        response.dragged_by(PointerButton::Middle) || (shift && response.dragged_by(PointerButton::Primary));
    if drag != DVec2::ZERO {
        if pans {
            model.move_camera(|camera| camera.pan(drag));
        } else if response.dragged_by(PointerButton::Primary) {
            let turn = drag * ORBIT_RAD_PER_HEIGHT;
            model.move_camera(|camera| camera.orbit(turn.x, turn.y));
        } else if response.dragged_by(PointerButton::Secondary) {
            let turn = drag * LOOK_RAD_PER_HEIGHT;
            model.move_camera(|camera| camera.look(-turn.x, -turn.y));
        }
    }
    if response.dragged_by(PointerButton::Secondary) || response.is_pointer_button_down_on() {
        fly(ui, model);
    }
    if response.hovered() {
        let (scroll, zoom) =
            ui.input(|input| (f64::from(input.smooth_scroll_delta().y), f64::from(input.zoom_delta())));
        let factor = (-scroll * DOLLY_PER_POINT).exp() / zoom;
        if factor != 1.0 {
            model.move_camera(|camera| camera.dolly(factor));
        }
    }
}

/// Keys that move while the right button is held.
fn fly(ui: &Ui, model: &mut Model) {
    let (direction, seconds, fast) = ui.input(|input| {
        let axis = |plus, minus| f64::from(i8::from(input.key_down(plus)) - i8::from(input.key_down(minus)));
        let direction = FlyDirection {
            right: axis(Key::D, Key::A),
            up: axis(Key::E, Key::Q),
            forward: axis(Key::W, Key::S),
        };
        let held = input.pointer.secondary_down();
        let direction = if held { direction } else { FlyDirection::default() };
        (direction, f64::from(input.stable_dt).min(FLY_STEP_MAX_S), input.modifiers.shift)
    });
    if direction == FlyDirection::default() {
        return;
    }
    let speed = model.scene_radius_m() * FLY_RADII_PER_SECOND * if fast { FLY_FAST } else { 1.0 };
    model.move_camera(|camera| camera.fly(direction, speed * seconds));
    ui.ctx().request_repaint();
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_keeps_its_shape_and_one_of_the_asked_size_fills_the_window() {
        let rect = Rect::from_min_size(pos2(10.0, 20.0), vec2(800.0, 450.0));
        let square = fitted(rect, vec2(100.0, 100.0), 1.0);
        assert_eq!(square.size(), vec2(450.0, 450.0));
        assert_eq!(square.center(), rect.center());
        // 1200.4 pixels wide, asked for as 1200.
        let odd = Rect::from_min_size(Pos2::ZERO, vec2(800.27, 450.0));
        assert_eq!(fitted(odd, vec2(1200.0, 675.0), 1.5), odd);
    }
}
