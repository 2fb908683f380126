//! The binary messages: a fixed header of 64 bytes, little-endian, then the payload.
//!
//! | offset | type | field |
//! | --- | --- | --- |
//! | 0 | `[u8; 4]` | magic, `LCF1` |
//! | 4 | u8 | kind: 1 frame, 2 tile, 3 light-map delta |
//! | 5 | u8 | version, 1 |
//! | 6 | u8 | codec: 1 JPEG, 2 PNG, 3 f32 RGB radiance |
//! | 7 | u8 | flags: bit 0 converged, bit 1 first frame drawn from this camera stamp |
//! | 8 | u64 | revision |
//! | 16 | u64 | frame number |
//! | 24 | u64 | camera stamp |
//! | 32, 34 | u16 | width, height of the payload's picture |
//! | 36, 38 | u16 | full width, full height |
//! | 40, 42 | u16 | x, y of a tile |
//! | 44 | f32 | error, −1 = not measured yet |
//! | 48 | u32 | samples per pixel |
//! | 52 | u32 | payload bytes |
//! | 56 | u32 | age in µs |
//! | 60 | u32 | reserved, 0 |

/// Bytes of a header.
pub const HEADER_BYTES: usize = 64;
/// The first four bytes.
pub const MAGIC: [u8; 4] = *b"LCF1";
/// Version of the header's layout.
pub const VERSION: u8 = 1;

const CONVERGED: u8 = 1;
const FIRST_FROM_STAMP: u8 = 2;
/// In place of an error: NaN would be a trap for every reader.
const NOT_MEASURED: f32 = -1.0;

/// What the payload is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum PayloadKind {
    /// A whole picture; the viewer scales it to the full size.
    Frame = 1,
    /// A part of a picture, at full size, at `offset`.
    Tile = 2,
    /// A part of a light map, at `offset`.
    LightMapDelta = 3,
}

/// How the payload's picture is packed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum PayloadCodec {
    /// JPEG, sRGB, after exposure and tone map.
    Jpeg = 1,
    /// PNG, 8-bit sRGB, after exposure and tone map.
    Png = 2,
    /// `[height × width × 3]` f32 little-endian, linear radiance W/(m² sr), rows from top to bottom.
    Float = 3,
}

/// Everything about a picture but the picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrameHeader {
    /// What the payload is.
    pub kind: PayloadKind,
    /// How it is packed.
    pub codec: PayloadCodec,
    /// Whether the picture has reached its target error and rests.
    pub converged: bool,
    /// Whether this is the first frame drawn from `camera_stamp`: latency is measured at these.
    pub first_from_stamp: bool,
    /// Revision of the scene that it shows.
    pub revision: u64,
    /// Counts from 1 per connection; the client acknowledges it.
    pub frame: u64,
    /// Stamp of the camera message that it shows.
    pub camera_stamp: u64,
    /// Width and height of the payload's picture.
    pub size: [u16; 2],
    /// Width and height that the client asked for.
    pub full_size: [u16; 2],
    /// Where a tile's upper left corner is, x and y; 0 for a whole frame.
    pub offset: [u16; 2],
    /// √relMSE as a fraction: 0.01 = 1 %; `None` = not measured yet.
    pub error: Option<f32>,
    /// Per pixel.
    pub samples: u32,
    /// On the server: from receiving the camera message to sending this, in µs; stays at the top from 71 minutes on.
    pub age_us: u32,
}

/// Why bytes are no frame, or a frame cannot become bytes.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FrameError {
    /// Shorter than a header.
    #[error("a binary message of {bytes} bytes is shorter than its header of {HEADER_BYTES}")]
    Short {
        /// Length of the message.
        bytes: usize,
    },
    /// Not ours.
    #[error("a binary message begins with {found:?} instead of {MAGIC:?} (\"LCF1\")")]
    Magic {
        /// The first four bytes.
        found: [u8; 4],
    },
    /// Of another age.
    #[error(
        "a frame header has version {found}; this program reads version {VERSION}: update the older of the two"
    )]
    Version {
        /// What it says.
        found: u8,
    },
    /// A kind this program does not know.
    #[error("a frame header has kind {found}; known are 1 (frame), 2 (tile), 3 (light-map delta)")]
    Kind {
        /// What it says.
        found: u8,
    },
    /// A codec this program does not know.
    #[error("a frame header has codec {found}; known are 1 (JPEG), 2 (PNG), 3 (float)")]
    Codec {
        /// What it says.
        found: u8,
    },
    /// The message was cut, or the header lies.
    #[error("a frame header announces {announced} bytes of payload, {found} follow")]
    PayloadBytes {
        /// By the header.
        announced: u64,
        /// Behind it.
        found: u64,
    },
    /// A float picture has exactly 12 bytes a pixel.
    #[error("a float picture of {width}×{height} has {found} bytes instead of {expected}")]
    FloatBytes {
        /// Pixels.
        width: u16,
        /// Pixels.
        height: u16,
        /// 12 × width × height.
        expected: u64,
        /// Bytes of payload.
        found: u64,
    },
    /// No pixels, or a tile that sticks out.
    #[error("a picture of {size:?} at {offset:?} does not fit into {full_size:?}, or is empty")]
    Size {
        /// Width and height.
        size: [u16; 2],
        /// x and y.
        offset: [u16; 2],
        /// Width and height of the whole.
        full_size: [u16; 2],
    },
    /// Neither an error nor "not measured".
    #[error("a frame header has error {found}; a finite number from 0 on, or −1 for not measured")]
    Error {
        /// What it says.
        found: f32,
    },
    /// Does not fit the 32 bits of its length.
    #[error("a payload of {bytes} bytes is too long for a frame; ask for a smaller picture or another codec")]
    PayloadTooLarge {
        /// Its length.
        bytes: usize,
    },
}

impl FrameHeader {
    /// The header's bytes, for a payload of `payload_bytes`. Refuses what [`FrameHeader::decode`] would refuse.
    pub fn encode(&self, payload_bytes: usize) -> Result<[u8; HEADER_BYTES], FrameError> {
        let announced =
            u32::try_from(payload_bytes).map_err(|_| FrameError::PayloadTooLarge { bytes: payload_bytes })?;
        self.check(payload_bytes as u64)?;
        let mut bytes = [0; HEADER_BYTES];
        let mut put = |at: usize, field: &[u8]| bytes[at..at + field.len()].copy_from_slice(field);
        put(0, &MAGIC);
        let flags = if self.converged { CONVERGED } else { 0 }
            | if self.first_from_stamp { FIRST_FROM_STAMP } else { 0 };
        put(4, &[self.kind as u8, VERSION, self.codec as u8, flags]);
        put(8, &self.revision.to_le_bytes());
        put(16, &self.frame.to_le_bytes());
        put(24, &self.camera_stamp.to_le_bytes());
        for (at, [first, second]) in [(32, self.size), (36, self.full_size), (40, self.offset)] {
            put(at, &first.to_le_bytes());
            put(at + 2, &second.to_le_bytes());
        }
        put(44, &self.error.unwrap_or(NOT_MEASURED).to_le_bytes());
        put(48, &self.samples.to_le_bytes());
        put(52, &announced.to_le_bytes());
        put(56, &self.age_us.to_le_bytes());
        Ok(bytes)
    }

    /// A whole binary message: header and payload.
    pub fn message(&self, payload: &[u8]) -> Result<Vec<u8>, FrameError> {
        let header = self.encode(payload.len())?;
        let mut message = Vec::with_capacity(HEADER_BYTES + payload.len());
        message.extend_from_slice(&header);
        message.extend_from_slice(payload);
        Ok(message)
    }

    /// Splits a binary message into header and payload. Unknown flags and the reserved bytes are ignored: a later
    /// server may use them.
    pub fn decode(message: &[u8]) -> Result<(Self, &[u8]), FrameError> {
        let (bytes, payload) =
            message.split_first_chunk::<HEADER_BYTES>().ok_or(FrameError::Short { bytes: message.len() })?;
        let found = bytes_at(bytes, 0);
        if found != MAGIC {
            return Err(FrameError::Magic { found });
        }
        let [kind, version, codec, flags] = bytes_at(bytes, 4);
        if version != VERSION {
            return Err(FrameError::Version { found: version });
        }
        let pair =
            |at| [u16::from_le_bytes(bytes_at(bytes, at)), u16::from_le_bytes(bytes_at(bytes, at + 2))];
        let error = f32::from_le_bytes(bytes_at(bytes, 44));
        let announced = u64::from(u32::from_le_bytes(bytes_at(bytes, 52)));
        let header = Self {
            kind: kind_of(kind)?,
            codec: codec_of(codec)?,
            converged: flags & CONVERGED != 0,
            first_from_stamp: flags & FIRST_FROM_STAMP != 0,
            revision: u64::from_le_bytes(bytes_at(bytes, 8)),
            frame: u64::from_le_bytes(bytes_at(bytes, 16)),
            camera_stamp: u64::from_le_bytes(bytes_at(bytes, 24)),
            size: pair(32),
            full_size: pair(36),
            offset: pair(40),
            error: (error != NOT_MEASURED).then_some(error),
            samples: u32::from_le_bytes(bytes_at(bytes, 48)),
            age_us: u32::from_le_bytes(bytes_at(bytes, 56)),
        };
        let found = payload.len() as u64;
        if announced != found {
            return Err(FrameError::PayloadBytes { announced, found });
        }
        header.check(found)?;
        Ok((header, payload))
    }

    /// What holds for every header, written or read.
    fn check(&self, payload_bytes: u64) -> Result<(), FrameError> {
        if let Some(found) = self.error.filter(|error| !error.is_finite() || *error < 0.0) {
            return Err(FrameError::Error { found });
        }
        let [width, height] = self.size;
        let fits = |axis: usize| {
            let end = u32::from(self.offset[axis]) + u32::from(self.size[axis]);
            self.size[axis] > 0 && end <= u32::from(self.full_size[axis])
        };
        if !(fits(0) && fits(1)) {
            return Err(FrameError::Size { size: self.size, offset: self.offset, full_size: self.full_size });
        }
        let expected = 12 * u64::from(width) * u64::from(height);
        if self.codec == PayloadCodec::Float && payload_bytes != expected {
            return Err(FrameError::FloatBytes { width, height, expected, found: payload_bytes });
        }
        Ok(())
    }
}

/// `N` bytes of a header, as an array that `from_le_bytes` takes.
fn bytes_at<const N: usize>(header: &[u8; HEADER_BYTES], at: usize) -> [u8; N] {
    std::array::from_fn(|i| header[at + i])
}

fn kind_of(found: u8) -> Result<PayloadKind, FrameError> {
    match found {
        1 => Ok(PayloadKind::Frame),
        2 => Ok(PayloadKind::Tile),
        3 => Ok(PayloadKind::LightMapDelta),
        _ => Err(FrameError::Kind { found }),
    }
}

fn codec_of(found: u8) -> Result<PayloadCodec, FrameError> {
    match found {
        1 => Ok(PayloadCodec::Jpeg),
        2 => Ok(PayloadCodec::Png),
        3 => Ok(PayloadCodec::Float),
        _ => Err(FrameError::Codec { found }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn header() -> FrameHeader {
        FrameHeader {
            kind: PayloadKind::Tile,
            codec: PayloadCodec::Jpeg,
            converged: true,
            first_from_stamp: true,
            revision: 0x0102_0304_0506_0708,
            frame: 9,
            camera_stamp: 10,
            size: [11, 12],
            full_size: [1300, 1400],
            offset: [15, 16],
            error: Some(0.25),
            samples: 17,
            age_us: 18,
        }
    }

    /// A good message with some bytes replaced.
    fn with_bytes(at: usize, bytes: &[u8]) -> Result<FrameHeader, FrameError> {
        let mut message = header().message(b"jpeg").unwrap();
        message[at..at + bytes.len()].copy_from_slice(bytes);
        FrameHeader::decode(&message).map(|(header, _)| header)
    }

    #[test]
    fn every_field_lies_where_the_document_says() {
        let bytes = header().encode(4).unwrap();
        let expected: [(usize, &[u8]); 15] = [
            (0, b"LCF1"),
            (4, &[2, 1, 1, 3]),
            (8, &[8, 7, 6, 5, 4, 3, 2, 1]),
            (16, &[9, 0, 0, 0, 0, 0, 0, 0]),
            (24, &[10, 0, 0, 0, 0, 0, 0, 0]),
            (32, &[11, 0]),
            (34, &[12, 0]),
            (36, &1300u16.to_le_bytes()),
            (38, &1400u16.to_le_bytes()),
            (40, &[15, 0, 16, 0]),
            (44, &0.25f32.to_le_bytes()),
            (48, &[17, 0, 0, 0]),
            (52, &[4, 0, 0, 0]),
            (56, &[18, 0, 0, 0]),
            (60, &[0, 0, 0, 0]),
        ];
        for (at, field) in expected {
            assert_eq!(&bytes[at..at + field.len()], field, "offset {at}");
        }
    }

    #[test]
    fn what_is_written_is_read_again() {
        let plain = FrameHeader { error: None, converged: false, first_from_stamp: false, ..header() };
        let float =
            FrameHeader { codec: PayloadCodec::Float, kind: PayloadKind::Frame, size: [2, 1], ..header() };
        for (header, payload) in [(header(), &b"jpeg"[..]), (plain, &b""[..]), (float, &[7; 24][..])] {
            let message = header.message(payload).unwrap();
            assert_eq!(FrameHeader::decode(&message), Ok((header, payload)));
        }
    }

    #[test]
    fn a_hostile_message_is_refused_with_its_reason() {
        let whole = header().message(b"jpeg").unwrap();
        for bytes in 0..HEADER_BYTES {
            assert_eq!(FrameHeader::decode(&whole[..bytes]), Err(FrameError::Short { bytes }));
        }
        for cut in [&whole[..HEADER_BYTES], &whole[..HEADER_BYTES + 3], &[&whole[..], b"more"].concat()] {
            assert!(matches!(FrameHeader::decode(cut), Err(FrameError::PayloadBytes { announced: 4, .. })));
        }
        assert_eq!(with_bytes(0, b"LCF2"), Err(FrameError::Magic { found: *b"LCF2" }));
        for found in [0, 4, 255] {
            assert_eq!(with_bytes(4, &[found]), Err(FrameError::Kind { found }));
            assert_eq!(with_bytes(5, &[found]), Err(FrameError::Version { found }));
            assert_eq!(with_bytes(6, &[found]), Err(FrameError::Codec { found }));
        }
        for error in [f32::NAN, f32::INFINITY, -0.5, -2.0] {
            assert!(matches!(with_bytes(44, &error.to_le_bytes()), Err(FrameError::Error { .. })), "{error}");
        }
        // No pixels; wider than the whole; pushed over the edge; an offset that would overflow 16 bits.
        for (at, bytes) in [(32, [0, 0]), (34, [0, 0]), (32, [255, 255]), (40, [10, 5]), (42, [255, 255])] {
            assert!(matches!(with_bytes(at, &bytes), Err(FrameError::Size { .. })), "offset {at}");
        }
        assert!(matches!(with_bytes(6, &[3]), Err(FrameError::FloatBytes { expected: 1584, found: 4, .. })));
        assert!(matches!(with_bytes(52, &[255; 4]), Err(FrameError::PayloadBytes { .. })));
    }

    #[test]
    fn no_pattern_of_bytes_panics() {
        // A fixed xorshift: the same patterns on every machine. The magic is right, so that the rest is looked at.
        let mut state = 0x9e37_79b9_7f4a_7c15_u64;
        for _ in 0..20_000 {
            let mut message = [0_u8; HEADER_BYTES + 12];
            for byte in &mut message {
                state ^= state << 13;
                state ^= state >> 7;
                state ^= state << 17;
                *byte = state as u8;
            }
            let (kind, codec) = (1 + message[4] % 3, 1 + message[6] % 3);
            message[..7].copy_from_slice(&[b'L', b'C', b'F', b'1', kind, 1, codec]);
            message[52..56].copy_from_slice(&12_u32.to_le_bytes());
            if let Ok((header, payload)) = FrameHeader::decode(&message) {
                assert_eq!(FrameHeader::decode(&header.message(payload).unwrap()), Ok((header, payload)));
            }
        }
    }

    #[test]
    fn unknown_flags_and_reserved_bytes_are_left_to_later_servers() {
        assert_eq!(with_bytes(7, &[0xff]), Ok(header()));
        assert_eq!(with_bytes(60, &[1, 2, 3, 4]), Ok(header()));
    }

    #[test]
    fn a_header_that_could_not_be_read_is_not_written() {
        assert!(FrameHeader { error: Some(f32::NAN), ..header() }.encode(4).is_err());
        assert!(FrameHeader { size: [0, 1], ..header() }.encode(4).is_err());
        assert!(FrameHeader { codec: PayloadCodec::Float, ..header() }.encode(4).is_err());
        assert!(matches!(header().encode(1 << 32), Err(FrameError::PayloadTooLarge { .. })));
    }
}
