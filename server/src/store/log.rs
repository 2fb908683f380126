//! The log of one scene: a line of magic, then records of length, checksum and JSON.
//!
//! Record: u32 LE payload bytes · u32 LE CRC-32 of the payload · payload. A record that was being written when the
//! power went is the last one, cut or wrong: it was never acknowledged and is cut off with a warning. A wrong record
//! with whole ones behind it is damage and refuses the scene, because cutting there would lose acknowledged edits.

use super::{Record, StoreError, failed};
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

const MAGIC: &[u8; 8] = b"LUMILOG1";
const HEAD_BYTES: usize = 8;

/// An open log, at its end.
#[derive(Debug)]
pub struct Log {
    path: PathBuf,
    file: File,
    bytes: u64,
    /// A failed write could not be taken back.
    poisoned: bool,
}

impl Log {
    /// A new, empty log; replaces a file of that name.
    pub fn create(path: &Path) -> Result<Log, StoreError> {
        let mut file = File::create(path).map_err(failed("make", path))?;
        file.write_all(MAGIC).map_err(failed("write", path))?;
        file.sync_all().map_err(failed("sync", path))?;
        Ok(Log { path: path.into(), file, bytes: MAGIC.len() as u64, poisoned: false })
    }

    /// Refuses every further batch.
    pub fn poison(&mut self) {
        self.poisoned = true;
    }

    /// Reads a log and opens it for appending; the text says what was cut off, if anything was.
    pub fn open(path: &Path) -> Result<(Log, Vec<Record>, Option<String>), StoreError> {
        let mut file = File::options().read(true).write(true).open(path).map_err(failed("open", path))?;
        let mut content = Vec::new();
        file.read_to_end(&mut content).map_err(failed("read", path))?;
        let damaged = |reason: String| StoreError::Damaged { path: path.display().to_string(), reason };
        if !content.starts_with(MAGIC) {
            return Err(damaged("it does not begin as a log of this version".into()));
        }
        let mut records = Vec::new();
        let mut at = MAGIC.len();
        let mut warning = None;
        while at < content.len() {
            match read_record(&content[at..]) {
                Some((record, bytes)) => {
                    records.push(record);
                    at += bytes;
                }
                None if whole_record_follows(&content[at..]) => {
                    return Err(damaged(format!("byte {at} begins no record, but whole ones follow")));
                }
                None => {
                    let torn = content.len() - at;
                    warning = Some(format!(
                        "{}: the last {torn} bytes are an unfinished write and were cut off; it was never acknowledged",
                        path.display()
                    ));
                    break;
                }
            }
        }
        if warning.is_some() {
            file.set_len(at as u64).map_err(failed("cut", path))?;
            file.sync_all().map_err(failed("sync", path))?;
        }
        file.seek(SeekFrom::Start(at as u64)).map_err(failed("read", path))?;
        Ok((Log { path: path.into(), file, bytes: at as u64, poisoned: false }, records, warning))
    }

    /// Appends and syncs; on failure the file is as it was.
    pub fn append(&mut self, encoded: &Encoded) -> Result<(), StoreError> {
        if self.poisoned {
            return Err(StoreError::Poisoned { path: self.path.display().to_string() });
        }
        let bytes = &encoded.bytes;
        let written = self.file.write_all(bytes).and_then(|()| self.file.sync_data());
        if let Err(error) = written {
            let undone = self
                .file
                .set_len(self.bytes)
                .and_then(|()| self.file.seek(SeekFrom::Start(self.bytes)))
                .and_then(|_| self.file.sync_data());
            self.poisoned = undone.is_err();
            return Err(failed("append to", &self.path)(error));
        }
        self.bytes += bytes.len() as u64;
        Ok(())
    }

    /// Length of the file.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }
}

/// A batch as it goes into the log, and as it will be read from there.
///
/// JSON numbers are read fast, not exactly: a double written and read again may differ in its last bit. So a batch is
/// read back from its own bytes before it is applied, and a replay of those bytes is the same to the last bit.
#[derive(Debug)]
pub struct Encoded {
    bytes: Vec<u8>,
    /// What a replay will see; this is what to apply.
    pub record: Record,
}

impl Encoded {
    /// Encodes, and reads back.
    pub fn new(record: &Record) -> io::Result<Encoded> {
        let bytes = encode(record)?;
        match read_record(&bytes) {
            Some((record, _)) => Ok(Encoded { bytes, record }),
            None => Err(io::Error::other("a batch cannot be read back from its own bytes")),
        }
    }

    /// Length in the log.
    pub fn len_bytes(&self) -> u64 {
        self.bytes.len() as u64
    }
}

fn encode(record: &Record) -> io::Result<Vec<u8>> {
    let payload = serde_json::to_vec(record).map_err(io::Error::other)?;
    let length = u32::try_from(payload.len())
        .map_err(|_| io::Error::other("a batch of more than 4 GiB does not fit one record"))?;
    let mut bytes = Vec::with_capacity(HEAD_BYTES + payload.len());
    bytes.extend_from_slice(&length.to_le_bytes());
    bytes.extend_from_slice(&crc32fast::hash(&payload).to_le_bytes());
    bytes.extend_from_slice(&payload);
    Ok(bytes)
}

/// The record at the front and its bytes; `None` where there is no whole, right one.
fn read_record(bytes: &[u8]) -> Option<(Record, usize)> {
    let (length, rest) = bytes.split_first_chunk::<4>()?;
    let (crc, rest) = rest.split_first_chunk::<4>()?;
    let length = u32::from_le_bytes(*length) as usize;
    let payload = rest.get(..length)?;
    if length == 0 || crc32fast::hash(payload) != u32::from_le_bytes(*crc) {
        return None;
    }
    Some((serde_json::from_slice(payload).ok()?, HEAD_BYTES + length))
}

/// Whether a whole record begins anywhere behind the front. Every payload begins with this text, so only those places
/// are tried.
fn whole_record_follows(bytes: &[u8]) -> bool {
    const START: &[u8] = b"{\"revision\":";
    (1..bytes.len().saturating_sub(HEAD_BYTES))
        .any(|at| bytes[at + HEAD_BYTES..].starts_with(START) && read_record(&bytes[at..]).is_some())
}
