//! `/v1/scenes/{id}/frame`: one picture.

use super::{HttpProblem, Service};
use crate::config::Config;
use crate::convert;
use crate::duration::parse_duration;
use crate::scenes::{PictureFormat, PictureRequest, Until};
use axum::extract::rejection::QueryRejection;
use axum::extract::{Path, Query, State};
use axum::http::header;
use axum::response::{IntoResponse, Response};
use lumicast_engine::film::{PictureSize, ToneMap};
use lumicast_engine::render::Indirect;
use lumicast_protocol::{Accuracy, Preset, ProblemKind, Technique};
use serde::Deserialize;
use std::time::Duration;

/// Parameters as text, so that each refusal can name its own.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FrameQuery {
    camera: Option<String>,
    size: Option<String>,
    format: Option<String>,
    error: Option<String>,
    time: Option<String>,
    technique: Option<String>,
    tone_map: Option<String>,
    exposure_ev: Option<f32>,
}

/// Draws one picture of the scene as it is now, by the best chain of techniques, as viewers see it with `auto`, or by one of them. It is done at `error` or after `time`, whatever comes first; with `error` alone after `frame_seconds_max` of the settings at the latest, with neither after `frame_seconds`. It begins with what the scene keeps of its light from the last who looked at it, or asked for a picture, if nobody looks now (`kept_light_s`), and learns together with those that are being drawn.
#[utoipa::path(get, path = "/v1/scenes/{id}/frame", tag = "pictures",
    params(
        ("id" = String, Path, description = "Scene"),
        ("camera" = Option<String>, Query, description = "A camera of the scene; default: the first"),
        ("size" = Option<String>, Query, description = "WxH in pixels, such as 640x360"),
        ("format" = Option<String>, Query, description = "png (default), jpeg, or exr: linear radiance"),
        ("error" = Option<String>, Query, description = "√relMSE at which it is done, as a fraction or in percent, such as 0.02 or 2%: measured, the upper end of its 95 % interval not a tenth above, and found so again at pixels taken afresh; converged: only `time` and the server's limits end it"),
        ("time" = Option<String>, Query, description = "Time after which it is done, seconds where no unit is said: 2, 2s, 500ms or 1m"),
        ("technique" = Option<String>, Query, description = "Of indirect light: auto (default), octree, irradiance, path or none"),
        ("tone_map" = Option<String>, Query, description = "linear, reinhard, aces (default) or agx; not for exr"),
        ("exposure_ev" = Option<f32>, Query, description = "Stops, −32 to 32; not for exr")),
    responses(
        (status = 200, description = "The picture", content((Vec<u8> = "image/png"), (Vec<u8> = "image/jpeg"), (Vec<u8> = "image/x-exr")),
            headers(
                ("ETag" = String, description = "Revision in quotes"),
                ("Lumicast-Samples" = u32, description = "Per pixel"),
                ("Lumicast-Error" = f64, description = "√relMSE as a fraction, where it was measured"),
                ("Lumicast-Error-Interval" = String, description = "The 95 % confidence interval of it: two fractions, low and high, with a comma between"),
                ("Lumicast-Done-By" = String, description = "What ended it: error, time or samples (the server's `samples_max`)"),
                ("Lumicast-Seconds" = f64, description = "Spent on it"))),
        (status = 400, description = "A parameter that is not known, or is none", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json"),
        (status = 404, description = "No such scene or camera", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json"),
        (status = 422, description = "A parameter is out of range", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json"),
        (status = 503, description = "Too many pictures at once", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json")))]
pub(super) async fn get(
    State(service): State<Service>,
    Path(id): Path<String>,
    query: Result<Query<FrameQuery>, QueryRejection>,
) -> Result<Response, HttpProblem> {
    let scene = service.scene(&id)?;
    let Query(query) = query.map_err(HttpProblem::of_query)?;
    let request = request_of(query, &service.scenes.workshop().config)?;
    let content_type = match request.format {
        PictureFormat::Exr => "image/x-exr",
        PictureFormat::Png => "image/png",
        PictureFormat::Jpeg => "image/jpeg",
    };
    let picture = scene.draw(request).await?;
    let mut response = (
        [
            ("content-type", content_type.to_string()),
            ("etag", format!("\"{}\"", picture.revision)),
            ("lumicast-samples", picture.samples.to_string()),
            ("lumicast-seconds", format!("{:.3}", picture.seconds)),
            ("lumicast-done-by", picture.done_by.name().to_string()),
        ],
        picture.bytes,
    )
        .into_response();
    if let Some(measured) = picture.measured {
        let [low, high] = measured.error_interval_95();
        let of_error = [
            ("lumicast-error", format!("{:.6}", measured.error())),
            ("lumicast-error-interval", format!("{low:.6}, {high:.6}")),
        ];
        for (name, text) in of_error {
            if let Ok(value) = header::HeaderValue::from_str(&text) {
                response.headers_mut().insert(name, value);
            }
        }
    }
    Ok(response)
}

/// - `value`: as it was asked for
/// - `reason`: what it may be
fn bad(field: &'static str, value: impl std::fmt::Display, reason: impl std::fmt::Display) -> HttpProblem {
    // Whoever sent something long knows it by its beginning.
    let value: String = value.to_string().chars().take(40).collect();
    HttpProblem::new(ProblemKind::ValueRefused, format!("parameter `{field}` is {value:?}: {reason}"))
        .at_field(field)
}

fn request_of(query: FrameQuery, config: &Config) -> Result<PictureRequest, HttpProblem> {
    let exposure_ev = query.exposure_ev.unwrap_or(0.0);
    if !(exposure_ev.abs() <= 32.0) {
        return Err(bad("exposure_ev", exposure_ev, "from −32 to 32 stops"));
    }
    let tone_map = match query.tone_map.as_deref() {
        None => ToneMap::Aces,
        Some(name) => {
            name.parse().map_err(|_| bad("tone_map", name, ToneMap::ALL.map(ToneMap::name).join(", ")))?
        }
    };
    Ok(PictureRequest {
        size: query.size.map(|text| size_of(&text, config)).transpose()?,
        format: match query.format.as_deref() {
            None | Some("png") => PictureFormat::Png,
            Some("jpeg" | "jpg") => PictureFormat::Jpeg,
            Some("exr") => PictureFormat::Exr,
            Some(format) => return Err(bad("format", format, "png, jpeg or exr")),
        },
        technique: query.technique.map_or(Ok(Indirect::Auto), |name| technique_of(&name))?,
        until: until_of(query.error.as_deref(), query.time.as_deref(), config)?,
        tone_map,
        exposure_ev,
        camera: query.camera,
    })
}

fn technique_of(name: &str) -> Result<Indirect, HttpProblem> {
    let is_meant = |technique: &Technique| technique.name() == name;
    let known = || Technique::ALL.map(Technique::name).join(", ");
    let technique =
        Technique::ALL.into_iter().find(is_meant).ok_or_else(|| bad("technique", name, known()))?;
    // Viewers are told the same of one that this server lacks.
    Ok(convert::indirect(technique)?.0)
}

fn size_of(text: &str, config: &Config) -> Result<PictureSize, HttpProblem> {
    let (width_max, height_max) = (config.picture_width, config.picture_height);
    let sides = text.split_once(['x', '×']).and_then(|(w, h)| Some((w.parse().ok()?, h.parse().ok()?)));
    match sides {
        Some((width, height))
            if (1..=width_max.into()).contains(&width) && (1..=height_max.into()).contains(&height) =>
        {
            PictureSize::new(width, height).map_err(|error| bad("size", text, error))
        }
        _ => Err(bad("size", text, format!("WxH from 1x1 to {width_max}x{height_max}, such as 640x360"))),
    }
}

fn until_of(error: Option<&str>, time: Option<&str>, config: &Config) -> Result<Until, HttpProblem> {
    let seconds_max = config.frame_seconds_max;
    let time = time.map(|text| time_of(text, seconds_max)).transpose()?;
    let longest = if error.is_some() { seconds_max } else { config.frame_seconds.min(seconds_max) };
    let error = match error {
        None => None,
        Some(text) if text == Preset::Converged.name() => None,
        Some(text) => Some(error_of(text)?),
    };
    Ok(Until { error, time: time.unwrap_or(Duration::from_secs_f64(longest)) })
}

fn error_of(text: &str) -> Result<f64, HttpProblem> {
    let no_error = || {
        // Addresses write the percent sign as %25.
        let meant = Accuracy::percent_meant(text).map(|meant| format!("; did you mean {meant}25?"));
        let must = "a fraction from 0.000001 on and below 1, or percent, such as 0.02 or 2%, or converged";
        bad("error", text, format!("{must}{}", meant.unwrap_or_default()))
    };
    Accuracy::read_target(text).ok_or_else(no_error)
}

fn time_of(text: &str, seconds_max: f64) -> Result<Duration, HttpProblem> {
    match parse_duration(text) {
        Ok(time) if time.as_secs_f64() <= seconds_max => Ok(time),
        _ => Err(bad("time", text, format!("above 0, at most {seconds_max} s: 2, 2s, 500ms or 1m"))),
    }
}
