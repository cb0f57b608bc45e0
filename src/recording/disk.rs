//! The file under a recording as the disk sees it: room, safety, existence.

use rustix::fs::{FallocateFlags, fallocate, fsync};
use rustix::io::Errno;
use std::fs::File;
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::Path;

/// Room is asked for in steps of this size, bytes.
const STEP: u64 = 4 << 20;

/// A handle on the regular file a recording is written to.
pub(super) struct Disk {
    file: File,
    /// The file system keeps room up to this byte for us.
    reserved: u64,
    /// False where the file system cannot reserve.
    reserves: bool,
}

impl Disk {
    pub fn new(file: File) -> Self {
        Self {
            file,
            reserved: 0,
            reserves: true,
        }
    }

    /// Makes sure that the file can grow to `bytes`. What is reserved and not used is given back
    /// by [`trim`](Self::trim).
    ///
    /// # Errors
    /// The disk is full, or the file would be larger than the file system (or a limit) allows.
    pub fn reserve(&mut self, bytes: u64) -> io::Result<()> {
        if !self.reserves || bytes <= self.reserved {
            return Ok(());
        }
        // a little ahead, so that the system is not asked for each frame
        for end in [bytes.saturating_add(STEP), bytes] {
            let more = end - self.reserved;
            match fallocate(&self.file, FallocateFlags::KEEP_SIZE, self.reserved, more) {
                Ok(()) => {
                    self.reserved = end;
                    return Ok(());
                }
                Err(Errno::NOSPC | Errno::DQUOT | Errno::FBIG) if end > bytes => {}
                Err(full @ (Errno::NOSPC | Errno::DQUOT | Errno::FBIG)) => return Err(full.into()),
                // FAT and some network file systems: writing will tell
                Err(_) => {
                    self.reserves = false;
                    return Ok(());
                }
            }
        }
        Ok(())
    }

    /// Gives reserved room after `bytes` back.
    pub fn trim(&self, bytes: u64) {
        if self.reserved > bytes {
            // a failure leaves some room reserved and no byte wrong
            let _ = self.file.set_len(bytes);
        }
    }

    /// Waits until the file's bytes are on the disk.
    pub fn sync(&self) -> io::Result<()> {
        self.file.sync_data()
    }

    /// False where the file was deleted: what is written goes nowhere.
    pub fn exists(&self) -> bool {
        self.file.metadata().is_ok_and(|facts| facts.nlink() > 0)
    }
}

/// Waits until the folder's entry of the file is on the disk.
///
/// # Errors
/// The system's. A folder that cannot be opened for reading is left alone.
pub(super) fn sync_folder(path: &Path) -> io::Result<()> {
    let folder = match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    match File::open(folder) {
        // some file systems have no such call for folders
        Ok(folder) => match fsync(&folder) {
            Ok(()) | Err(Errno::INVAL | Errno::NOTSUP) => Ok(()),
            Err(error) => Err(error.into()),
        },
        Err(_) => Ok(()),
    }
}
