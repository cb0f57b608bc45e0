//! Do the lengths inside a record fit in it? Asked before a record is parsed.
//!
//! The `mcap` crate takes memory for a text of any announced length before it looks whether the
//! text is there: eight damaged bytes would cost gigabytes.

use mcap::records::op;

/// One field of a record.
#[derive(Clone, Copy)]
enum Field {
    /// So many bytes.
    Fixed(usize),
    /// A u32 and so many bytes: a text, or a list of fixed entries.
    Sized,
    /// A u32 and so many bytes that are texts, each [`Field::Sized`].
    Texts,
    /// A u64 and so many bytes.
    Long,
}

use Field::{Fixed, Long, Sized, Texts};

/// The fields up to the last one with a length, by <https://mcap.dev/spec>.
fn fields(code: u8) -> &'static [Field] {
    match code {
        op::HEADER => &[Sized, Sized],
        op::FOOTER => &[Fixed(20)],
        op::SCHEMA => &[Fixed(2), Sized, Sized, Sized],
        op::CHANNEL => &[Fixed(4), Sized, Sized, Texts],
        op::MESSAGE => &[Fixed(22)],
        op::CHUNK => &[Fixed(28), Sized, Long],
        op::MESSAGE_INDEX => &[Fixed(2), Sized],
        op::CHUNK_INDEX => &[Fixed(32), Sized, Fixed(8), Sized, Fixed(16)],
        op::ATTACHMENT => &[Fixed(16), Sized, Sized, Long, Fixed(4)],
        op::ATTACHMENT_INDEX => &[Fixed(40), Sized, Sized],
        op::STATISTICS => &[Fixed(42), Sized],
        op::METADATA => &[Sized, Texts],
        op::METADATA_INDEX => &[Fixed(16), Sized],
        op::SUMMARY_OFFSET => &[Fixed(17)],
        op::DATA_END => &[Fixed(4)],
        _ => &[],
    }
}

/// True where every field lies inside `body`. `O(fields)`, and texts in a map.
pub(super) fn fits(code: u8, body: &[u8]) -> bool {
    let mut rest = body;
    fields(code).iter().all(|field| match field {
        Fixed(bytes) => take(&mut rest, *bytes as u64).is_some(),
        Sized => sized(&mut rest).is_some(),
        Texts => sized(&mut rest).is_some_and(|mut texts| {
            while !texts.is_empty() {
                if sized(&mut texts).is_none() {
                    return false;
                }
            }
            true
        }),
        Long => take(&mut rest, 8)
            .and_then(|eight| eight.try_into().ok())
            .and_then(|eight| take(&mut rest, u64::from_le_bytes(eight)))
            .is_some(),
    })
}

fn take<'a>(rest: &mut &'a [u8], bytes: u64) -> Option<&'a [u8]> {
    let (taken, after) = rest.split_at_checked(usize::try_from(bytes).ok()?)?;
    *rest = after;
    Some(taken)
}

fn sized<'a>(rest: &mut &'a [u8]) -> Option<&'a [u8]> {
    let length = u32::from_le_bytes(take(rest, 4)?.try_into().ok()?);
    take(rest, u64::from(length))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_length_over_the_end_does_not_fit() {
        let text = |length: u32, bytes: &[u8]| [&length.to_le_bytes()[..], bytes].concat();
        let header = [text(4, b"ros2"), text(2, b"me")].concat();
        assert!(fits(op::HEADER, &header));
        for cut in 0..header.len() {
            assert!(!fits(op::HEADER, &header[..cut]), "{cut}");
        }
        let map = [text(1, b"k"), text(1, b"v")].concat();
        let whole = [text(1, b"n"), text(map.len() as u32, &map)].concat();
        assert!(fits(op::METADATA, &whole));
        // a text that runs over the end of its map, though not of the record
        let mut inner = [whole.clone(), vec![0; 9]].concat();
        inner[14] = 9;
        assert!(!fits(op::METADATA, &inner));
        // what no reader knows has no fields to look at
        assert!(fits(0x99, b""));
    }
}
