//! The channels again, in every chunk: the first chunk is no single place that may not be damaged.
//!
//! Each chunk begins with a private MCAP record (opcode [`OPCODE`]; other readers ignore it).
//! Its body is the channel records of the file so far, whole records one after another, byte for
//! byte as MCAP has them. The `saint` channel's metadata holds the camera, so one readable chunk
//! is enough to know all that is needed to play on from it.

use mcap::records::op;
use std::collections::BTreeMap;

/// MCAP leaves 0x80 and above to applications.
pub(super) const OPCODE: u8 = 0x80;

/// Appends a channel record to a description.
pub(super) fn add_channel(
    description: &mut Vec<u8>,
    (id, schema_id): (u16, u16),
    topic: &str,
    encoding: &str,
    metadata: &BTreeMap<String, String>,
) {
    let mut body = Vec::new();
    body.extend(id.to_le_bytes());
    body.extend(schema_id.to_le_bytes());
    text(&mut body, topic);
    text(&mut body, encoding);
    let mut map = Vec::new();
    for (key, value) in metadata {
        text(&mut map, key);
        text(&mut map, value);
    }
    length(&mut body, map.len());
    body.extend(map);
    description.push(op::CHANNEL);
    description.extend((body.len() as u64).to_le_bytes());
    description.extend(body);
}

fn text(bytes: &mut Vec<u8>, text: &str) {
    length(bytes, text.len());
    bytes.extend(text.as_bytes());
}

/// MCAP counts in 32 bits; topics and notes are far shorter.
fn length(bytes: &mut Vec<u8>, length: usize) {
    bytes.extend(u32::try_from(length).unwrap_or(u32::MAX).to_le_bytes());
}

#[cfg(test)]
mod tests {
    use super::*;
    use mcap::records::Record;

    #[test]
    fn the_bytes_are_mcaps_own() {
        let metadata = BTreeMap::from([("camera".to_owned(), "{}".to_owned())]);
        let mut description = Vec::new();
        add_channel(&mut description, (7, 3), "left/saint", "cdr", &metadata);
        let (head, body) = description.split_at(9);
        assert_eq!(head[0], op::CHANNEL);
        assert_eq!(head[1..], (body.len() as u64).to_le_bytes());
        let Ok(Record::Channel(channel)) = mcap::parse_record(head[0], body) else {
            panic!("no channel");
        };
        assert_eq!((channel.id, channel.schema_id), (7, 3));
        assert_eq!(
            (&*channel.topic, &*channel.message_encoding),
            ("left/saint", "cdr")
        );
        assert_eq!(channel.metadata, metadata);
    }
}
