//! EXR files: linear radiance without exposure, tone map or clamp, alone or with the film's layers.
//!
//! One part, 32-bit floats, ZIP by 16 lines. The plain picture is always in the channels `R`, `G`, `B`, so
//! that any reader finds it; layers are named channels beside it.

use std::io::Cursor;

use exr::prelude::{
    AnyChannel, AnyChannels, Encoding, FlatSamples, Image, Layer, LayerAttributes, ReadChannels, ReadLayers,
    SmallVec, Text, WritableImage, read,
};
use lumicast_engine::{
    film::{BadPictureSize, Picture, PictureSize},
    math::Rgb,
    transport::PathClass,
};
use serde::Serialize;

use super::EncodeError;

/// A layer of the film beside the plain picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExrLayer {
    /// Radiance of one path class.
    Class(PathClass),
    /// Albedo of the first hit.
    Albedo,
    /// Normal of the first hit.
    Normal,
    /// Depth of the first hit.
    Depth,
    /// Variance of the pixel's mean luminance.
    Variance,
}

/// What each layer is called and holds: the one table of `--layers`.
///
/// `R`, `G`, `B` are the sum of the five radiance layers. What mirrors, glass and glosses show of light that met a diffuse surface before
/// is in the layer of its last diffuse scattering; `specular` holds what they show of sources.
pub const EXR_LAYERS: [(&str, ExrLayer, &str); 9] = [
    ("emitted", ExrLayer::Class(PathClass::Emitted), "RGB, W/(m² sr): sources seen directly"),
    (
        "direct",
        ExrLayer::Class(PathClass::Direct),
        "RGB, W/(m² sr): light that falls on diffuse surfaces straight from sources",
    ),
    (
        "caustics",
        ExrLayer::Class(PathClass::Caustic),
        "RGB, W/(m² sr): light that reached diffuse surfaces by specular lobes only",
    ),
    (
        "indirect",
        ExrLayer::Class(PathClass::Indirect),
        "RGB, W/(m² sr): light with a further diffuse scattering before",
    ),
    (
        "specular",
        ExrLayer::Class(PathClass::Specular),
        "RGB, W/(m² sr): sources seen in mirrors and glosses and through glass",
    ),
    ("albedo", ExrLayer::Albedo, "RGB, share of light: first hit, black where nothing was hit"),
    (
        "normal",
        ExrLayer::Normal,
        "XYZ, unit: first hit's shading normal in the world, zero where nothing was hit",
    ),
    ("depth", ExrLayer::Depth, "Z, metres along the camera's axis: first hit, 0 where nothing was hit"),
    ("variance", ExrLayer::Variance, "Y, (W/(m² sr))²: variance of the pixel's mean luminance"),
];

/// Whether a file holds the plain picture alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExrLayers {
    /// `R`, `G`, `B`.
    Plain,
    /// `R`, `G`, `B` and every layer of [`EXR_LAYERS`].
    All,
}

/// How a picture came about, kept in the file as JSON in the attribute `lumicast`.
///
/// One attribute, not one each: the EXR library writes several in random order, and equal pictures should
/// be equal bytes.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PictureFacts {
    /// Revision of the scene.
    pub revision: u64,
    /// Seed of the random numbers.
    pub seed: u64,
    /// Samples that every pixel has.
    pub samples_per_pixel: u32,
    /// Name of the technique.
    pub technique: &'static str,
    /// Measured error, √relMSE; nothing below two samples.
    pub error: Option<f64>,
    /// 95 % confidence interval of `error`.
    pub error_ci: Option<[f64; 2]>,
    /// Seconds of work; only where a time limit decided when to stop, because otherwise the same command
    /// shall write the same bytes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seconds: Option<f64>,
}

/// The bytes of an EXR file.
pub fn encode_exr(
    picture: &Picture<'_>,
    layers: ExrLayers,
    facts: &PictureFacts,
) -> Result<Vec<u8>, EncodeError> {
    let size = picture.size();
    let fail = |reason: String| EncodeError::new("EXR", size, reason);
    let mut channels = SmallVec::new();
    add_vectors(&mut channels, "", "RGB", picture.radiance().iter().map(|colour| colour.to_array()));
    if layers == ExrLayers::All {
        EXR_LAYERS.iter().for_each(|(name, layer, _)| add_layer(&mut channels, picture, name, *layer));
    }
    let software = Text::from(concat!("lumicast ", env!("CARGO_PKG_VERSION")));
    let mut attributes = LayerAttributes { software_name: Some(software), ..LayerAttributes::default() };
    let facts = serde_json::to_string(facts).map_err(|error| fail(error.to_string()))?;
    attributes
        .other
        .insert(Text::from("lumicast"), exr::prelude::AttributeValue::Text(facts.as_str().into()));
    let sides = (size.width() as usize, size.height() as usize);
    let layer = Layer::new(sides, attributes, Encoding::SMALL_LOSSLESS, AnyChannels::sort(channels));
    let mut bytes = Cursor::new(Vec::new());
    // Not parallel: the library would start a thread per core, whatever `--threads` says.
    let written = Image::from_layer(layer).write().non_parallel().to_buffered(&mut bytes);
    written.map_err(|error| fail(error.to_string()))?;
    Ok(bytes.into_inner())
}

type Channels = SmallVec<[AnyChannel<FlatSamples>; 4]>;

fn add_layer(channels: &mut Channels, picture: &Picture<'_>, name: &str, layer: ExrLayer) {
    let prefix = format!("{name}.");
    let colours = |image: Vec<Rgb>| image.into_iter().map(Rgb::to_array);
    match layer {
        ExrLayer::Class(class) => add_vectors(channels, &prefix, "RGB", colours(picture.layer(class))),
        ExrLayer::Albedo => add_vectors(channels, &prefix, "RGB", colours(picture.albedo())),
        ExrLayer::Normal => add_vectors(
            channels,
            &prefix,
            "XYZ",
            picture.normal().into_iter().map(|normal| normal.to_array()),
        ),
        ExrLayer::Depth => {
            add_vectors(channels, &prefix, "Z", picture.depth().into_iter().map(|depth| [depth]))
        }
        ExrLayer::Variance => {
            add_vectors(channels, &prefix, "Y", picture.variance().into_iter().map(|variance| [variance]))
        }
    }
}

/// Adds one channel per letter of `letters`, taken from the vectors' components.
fn add_vectors<const N: usize>(
    channels: &mut Channels,
    prefix: &str,
    letters: &str,
    vectors: impl Iterator<Item = [f32; N]>,
) {
    let mut planes = [const { Vec::new() }; N];
    for vector in vectors {
        planes.iter_mut().zip(vector).for_each(|(plane, value)| plane.push(value));
    }
    for (letter, plane) in letters.chars().zip(planes) {
        let name = format!("{prefix}{letter}");
        channels.push(AnyChannel::new(Text::from(name.as_str()), FlatSamples::F32(plane)));
    }
}

/// An EXR file that is no picture to us.
#[derive(Debug, thiserror::Error)]
pub enum DecodeError {
    /// It is no EXR file, or has no layer of red, green and blue.
    #[error("not an EXR picture of red, green and blue: {0}")]
    Broken(#[from] exr::error::Error),
    /// It is larger than pictures may be.
    #[error(transparent)]
    TooLarge(#[from] BadPictureSize),
}

/// The plain picture of an EXR file, from its channels R, G and B: `[h × w]`, rows top to bottom.
pub fn decode_exr(bytes: &[u8]) -> Result<(PictureSize, Vec<Rgb>), DecodeError> {
    let image = read()
        .no_deep_data()
        .largest_resolution_level()
        .rgba_channels(
            |resolution, _| (resolution.width(), vec![Rgb::BLACK; resolution.area()]),
            |(width, pixels), position, (red, green, blue, _): (f32, f32, f32, f32)| {
                pixels[position.y() * *width + position.x()] = [red, green, blue].into();
            },
        )
        .first_valid_layer()
        .all_attributes()
        .from_buffered(Cursor::new(bytes))?;
    let resolution = image.layer_data.size;
    let side = |pixels: usize| u32::try_from(pixels).unwrap_or(u32::MAX);
    let size = PictureSize::new(side(resolution.width()), side(resolution.height()))?;
    Ok((size, image.layer_data.channel_data.pixels.1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use lumicast_engine::film::{Film, PixelSample};

    /// A film whose every channel of every layer differs.
    fn film() -> Film {
        let mut film = Film::new(PictureSize::new(21, 18).unwrap());
        for tile in film.tiles_mut() {
            for pass in 0..2 {
                tile.add_pass(|x, y| PixelSample {
                    radiance: std::array::from_fn(|class| {
                        Rgb::new(x as f32, y as f32, 1e6 + pass as f32) * (class as f32 + 0.1)
                    }),
                    albedo: Rgb::new(0.1, 0.2, 0.3),
                    normal: glam::Vec3::NEG_Y,
                    depth_m: 1.0 + x as f32,
                    is_shining: false,
                    beyond: None,
                });
            }
        }
        film
    }

    fn facts() -> PictureFacts {
        PictureFacts {
            revision: 3,
            seed: u64::MAX,
            samples_per_pixel: 2,
            technique: "path",
            error: Some(0.5),
            error_ci: Some([0.4, 0.6]),
            seconds: None,
        }
    }

    /// Radiance comes back bit by bit, with and without layers, far above 1.
    #[test]
    fn radiance_is_stored_in_full_precision() {
        let film = film();
        for layers in [ExrLayers::Plain, ExrLayers::All] {
            let bytes = encode_exr(&Picture::of(&film), layers, &facts()).unwrap();
            assert_eq!(decode_exr(&bytes).unwrap(), (film.size(), film.radiance()));
        }
    }

    /// Every layer of the table is in the file under its name, and nothing else is.
    #[test]
    fn layers_are_those_of_the_table() {
        use exr::prelude::MetaData;
        let bytes = encode_exr(&Picture::of(&film()), ExrLayers::All, &facts()).unwrap();
        let meta = MetaData::read_from_buffered(Cursor::new(&bytes), false).unwrap();
        let names: Vec<String> =
            meta.headers[0].channels.list.iter().map(|channel| channel.name.to_string()).collect();
        let mut expected: Vec<String> = EXR_LAYERS
            .iter()
            .flat_map(|(name, _, about)| {
                let letters = about.split(',').next().unwrap_or_default();
                letters.chars().map(move |letter| format!("{name}.{letter}"))
            })
            .chain(["R", "G", "B"].map(String::from))
            .collect();
        expected.sort();
        assert_eq!(names, expected);
        // Those that the contract names.
        for name in ["direct", "indirect", "caustics", "specular", "albedo", "normal", "depth"] {
            assert!(EXR_LAYERS.iter().any(|layer| layer.0 == name), "{name}");
        }
    }

    /// The facts are readable JSON in the file's header; a big seed keeps every digit.
    #[test]
    fn facts_are_in_the_header() {
        use exr::prelude::{AttributeValue, MetaData};
        let bytes = encode_exr(&Picture::of(&film()), ExrLayers::Plain, &facts()).unwrap();
        let meta = MetaData::read_from_buffered(Cursor::new(&bytes), false).unwrap();
        let attributes = &meta.headers[0].own_attributes;
        let Some(AttributeValue::Text(json)) = attributes.other.get(&Text::from("lumicast")) else {
            panic!("no attribute `lumicast`")
        };
        let value: serde_json::Value = serde_json::from_str(&json.to_string()).unwrap();
        assert_eq!(value["seed"], u64::MAX);
        assert_eq!(value["error_ci"][1], 0.6);
        assert!(value.get("seconds").is_none());
        assert!(attributes.software_name.as_ref().unwrap().to_string().starts_with("lumicast "));
    }

    /// The same film gives the same bytes.
    #[test]
    fn equal_films_are_equal_bytes() {
        let encode = || encode_exr(&Picture::of(&film()), ExrLayers::All, &facts()).unwrap();
        assert_eq!(encode(), encode());
    }
}
