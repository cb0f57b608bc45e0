//! Checksums made right again, so that damage gets past them.

/// The same bytes with a checksum that matches.
pub fn sealed(body: &[u8]) -> Vec<u8> {
    [body, &crc32fast::hash(body).to_le_bytes()].concat()
}

/// Writes right checksums into the uncompressed chunks of an MCAP file, as far as its records go on.
pub fn mend_chunks(file: &mut [u8]) {
    const CHUNK: u8 = 0x06;
    // chunk: two times, uncompressed size, its CRC-32, compression, size, records
    const CRC: usize = 24;
    const COMPRESSION: usize = 28;
    let mut at = 8;
    while let Some(&[opcode, ref length @ ..]) = file.get(at..).and_then(|f| f.first_chunk::<9>()) {
        let Ok(length) = usize::try_from(u64::from_le_bytes(*length)) else {
            return;
        };
        let start = at + 9;
        let Some(end) = start.checked_add(length).filter(|end| *end <= file.len()) else {
            return;
        };
        at = end;
        let content = &mut file[start..end];
        let uncompressed = content.get(COMPRESSION..COMPRESSION + 4) == Some(&[0; 4]);
        if opcode == CHUNK && uncompressed && content.len() >= COMPRESSION + 12 {
            let crc = crc32fast::hash(&content[COMPRESSION + 12..]);
            content[CRC..COMPRESSION].copy_from_slice(&crc.to_le_bytes());
        }
    }
}
