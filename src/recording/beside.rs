//! What stands in a file beside the chunks: attachments and metadata, of whichever program.

use super::container::{PREFIX, Source, parse};
use super::index::Place;
use mcap::Attachment;
use mcap::records::{Metadata, Record, op};

/// One of them.
pub(super) enum Beside {
    Attachment(Attachment<'static>),
    Metadata(Metadata),
}

/// Finds them one after another, from the beginning of a file.
pub(super) struct Walk<'a> {
    source: &'a Source,
    /// The file's chunks by offset: where there is no record, the next one stands there.
    places: &'a [&'a Place],
    at: u64,
}

impl<'a> Walk<'a> {
    pub fn new(source: &'a Source, places: &'a [&'a Place]) -> Self {
        Self {
            source,
            places,
            at: mcap::MAGIC.len() as u64,
        }
    }

    /// Goes to the next chunk, where there is one.
    fn leap(&mut self) -> bool {
        let next = self.places.partition_point(|place| place.offset <= self.at);
        self.places.get(next).is_some_and(|place| {
            self.at = place.offset;
            true
        })
    }

    /// The next one; of one that is damaged, where it is and what is wrong. `None` at the end.
    pub fn next(&mut self) -> Option<Result<Beside, (u64, String)>> {
        loop {
            let chunk = self
                .places
                .binary_search_by_key(&self.at, |place| place.offset);
            if let Ok(chunk) = chunk {
                self.at += self.places[chunk].length;
                continue;
            }
            let Ok((code, length)) = self.source.record_at(self.at) else {
                if self.leap() {
                    continue;
                }
                return None;
            };
            match code {
                op::ATTACHMENT | op::METADATA => {
                    let (at, body) = (self.at, self.at + PREFIX);
                    self.at = body + length;
                    let mut bytes = Vec::new();
                    let read = self.source.fill(body, length, &mut bytes);
                    let read = read.and_then(|()| known(code, &bytes));
                    return Some(read.map_err(|what| (at, what)));
                }
                op::DATA_END | op::FOOTER => {
                    if !self.leap() {
                        return None;
                    }
                }
                _ => self.at += PREFIX + length,
            }
        }
    }
}

/// An attachment proves itself by its checksum; metadata has none and must read well.
fn known(code: u8, bytes: &[u8]) -> Result<Beside, String> {
    match parse(code, bytes)? {
        Record::Attachment { header, data, .. } => Ok(Beside::Attachment(Attachment {
            log_time: header.log_time,
            create_time: header.create_time,
            name: header.name,
            media_type: header.media_type,
            data: data.into_owned().into(),
        })),
        Record::Metadata(metadata) => Ok(Beside::Metadata(metadata)),
        _ => Err("a record of another kind".to_owned()),
    }
}
