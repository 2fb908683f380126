//! How the picture is developed (exposure, tone map, codec) and how exact it is to become.

use super::forecast;
use super::form::{form, line, tick};
use crate::model::Model;
use egui::{ComboBox, DragValue, Response, Slider, Ui};
use lumicast_protocol::{Accuracy, Codec, Technique, ToneMap};

/// What a first tick of "limit bounces" asks for: most scenes change by less than a percent beyond it.
const BOUNCES_FIRST: u32 = 16;

/// Exposure, tone map, codec.
pub fn show_picture(ui: &mut Ui, model: &mut Model) {
    let mut quality = model.quality();
    form(ui, "picture", |ui| {
        line(ui, "Exposure", "Radiance × 2^EV. Double click: 0", |ui| {
            ui.spacing_mut().slider_width = 92.0;
            let slider = ui.add(
                Slider::new(&mut quality.exposure_ev, -10.0..=10.0)
                    .suffix(" EV")
                    .max_decimals(2)
                    .step_by(0.05),
            );
            if slider.double_clicked() {
                quality.exposure_ev = 0.0;
            }
            slider
        });
        line(ui, "Tone map", "From radiance to what a screen can show", |ui| {
            choice(ui, "tone map", &mut quality.tone_map, &ToneMap::ALL, tone_map_name)
        });
        line(
            ui,
            "Codec",
            "How pictures travel. Float is exact and large: exposure and tone map happen here",
            |ui| {
                choice(
                    ui,
                    "codec",
                    &mut quality.codec,
                    &[Codec::Auto, Codec::Jpeg, Codec::Png, Codec::Float],
                    codec_name,
                )
            },
        );
        let hint = "Dots where records of irradiance stand that the camera sees. Not in float pictures";
        tick(ui, "Show records", hint, &mut quality.show_records);
        if matches!(quality.codec, Codec::Auto | Codec::Jpeg) {
            line(ui, "JPEG quality", "Above about 85 it grows faster than it gains", |ui| {
                ui.spacing_mut().slider_width = 92.0;
                ui.add(Slider::new(&mut quality.jpeg_quality, 1..=100))
            });
        }
    });
    model.set_quality(quality);
}

/// Target error, technique, bounces.
pub fn show_accuracy(ui: &mut Ui, model: &mut Model) {
    let mut accuracy = model.accuracy();
    let bounces_max = model.hello.as_ref().map_or(1024, |hello| hello.limits.bounces.max(1));
    form(ui, "accuracy", |ui| {
        forecast::show_presets(ui, &mut accuracy);
        let mut percent = accuracy.target_error * 100.0;
        let changed = line(ui, "Target error", "At this error the picture rests (√relMSE)", |ui| {
            ui.spacing_mut().slider_width = 92.0;
            ui.add(Slider::new(&mut percent, 0.05..=50.0).logarithmic(true).suffix(" %").max_decimals(2))
        });
        if changed {
            (accuracy.target_error, accuracy.preset) = (percent / 100.0, None);
        }
        line(ui, "Technique", "Where indirect light comes from", |ui| {
            choice(ui, "technique", &mut accuracy.technique, &Technique::ALL, technique_name)
        });
        if matches!(accuracy.technique, Technique::Auto | Technique::Irradiance) {
            let hint = "Largest error between records of irradiance (Ward's a). Smaller takes more records; those there are stay. \
                        All who look at the scene share them: the smallest counts";
            line(ui, "Records' a", hint, |ui| {
                ui.spacing_mut().slider_width = 92.0;
                let [least, most] = Accuracy::IRRADIANCE_RANGE;
                let slider = Slider::new(&mut accuracy.irradiance_accuracy, least..=most);
                let slider = ui.add(slider.logarithmic(true).max_decimals(2));
                if slider.double_clicked() {
                    accuracy.irradiance_accuracy = Accuracy::default().irradiance_accuracy;
                }
                slider
            });
        }
        let mut limited = accuracy.bounces.is_some();
        if tick(
            ui,
            "Limit bounces",
            "Longest path of light, in surface hits; without limit it is exact",
            &mut limited,
        ) {
            accuracy.bounces = limited.then_some(BOUNCES_FIRST.min(bounces_max));
        }
        if let Some(bounces) = &mut accuracy.bounces {
            line(ui, "Bounces", "Longest path of light, in surface hits", |ui| {
                ui.add(DragValue::new(bounces).range(1..=bounces_max).speed(0.1))
            });
        }
    });
    model.set_accuracy(accuracy);
}

/// A menu of a few values.
pub(super) fn choice<T: PartialEq + Copy>(
    ui: &mut Ui,
    salt: &str,
    value: &mut T,
    all: &[T],
    name: fn(T) -> &'static str,
) -> Response {
    let before = *value;
    let combo = ComboBox::from_id_salt(salt).width(120.0).selected_text(name(*value)).show_ui(ui, |ui| {
        for option in all {
            ui.selectable_value(value, *option, name(*option));
        }
    });
    let mut response = combo.response;
    if *value != before {
        response.mark_changed();
    }
    response
}

fn tone_map_name(tone_map: ToneMap) -> &'static str {
    match tone_map {
        ToneMap::Linear => "Linear",
        ToneMap::Reinhard => "Reinhard",
        ToneMap::Aces => "ACES",
        ToneMap::Agx => "AgX",
    }
}

fn codec_name(codec: Codec) -> &'static str {
    match codec {
        Codec::Auto => "Auto",
        Codec::Jpeg => "JPEG",
        Codec::Png => "PNG",
        Codec::Float => "Float",
    }
}

fn technique_name(technique: Technique) -> &'static str {
    match technique {
        Technique::Auto => "Auto",
        Technique::Octree => "Octree",
        Technique::Irradiance => "Irradiance",
        Technique::Lightmap => "Light map",
        Technique::Path => "Path tracing",
        Technique::None => "None (direct only)",
    }
}
