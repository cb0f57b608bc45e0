//! The driver's frame buffers, mapped into memory.
//!
//! A buffer is either the kernel's (queued) or ours (taken); [`Ring::take`] and
//! [`Ring::give_back`] move it, and nothing else does. So a timeout, a signal or a stall between
//! the two leaves nothing out of step, and no frame is lost to recover from one.

use super::node::{KernelStruct, VideoNode};
use std::io;
use std::time::Duration;
use v4l::v4l_sys as sys;
use v4l::v4l2::vidioc;

const CAPTURE: u32 = sys::v4l2_buf_type_V4L2_BUF_TYPE_VIDEO_CAPTURE;
const MMAP: u32 = sys::v4l2_memory_V4L2_MEMORY_MMAP;

/// `V4L2_BUF_FLAG_DONE` of `<linux/videodev2.h>`: filled, and not taken yet.
const DONE: u32 = 4;

/// One buffer in our address space, unmapped on drop.
#[derive(Debug)]
struct Mapping {
    start: *mut u8,
    length: usize,
}

// SAFETY: the mapping belongs to this value alone; it is not tied to a thread.
#[allow(unsafe_code)]
unsafe impl Send for Mapping {}

impl Drop for Mapping {
    fn drop(&mut self) {
        // SAFETY: the range was mapped in `Ring::map` and no slice of it outlives the ring.
        #[allow(unsafe_code)]
        let unmapped = unsafe { v4l::v4l2::munmap(self.start.cast(), self.length) };
        if let Err(error) = unmapped {
            tracing::debug!(%error, "a frame buffer stays mapped");
        }
    }
}

/// A buffer taken from the kernel, to be given back.
#[derive(Debug)]
pub struct Taken {
    index: u32,
    /// Bytes the driver filled.
    pub bytes_used: usize,
    /// The driver calls the content damaged.
    pub damaged: bool,
    /// The driver says the stamp is CLOCK_MONOTONIC.
    pub monotonic: bool,
    /// The driver's frame number.
    pub sequence: u32,
    /// The driver's stamp, ns.
    pub stamp_ns: i64,
}

/// What waiting for a frame found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Waited {
    /// A buffer may be taken, or an error is there to be read by taking.
    Ready,
    /// Nothing within the time, or a signal came.
    Nothing,
}

/// A running stream of mapped buffers. Stopped on drop.
#[derive(Debug)]
pub struct Ring {
    node: VideoNode,
    mappings: Vec<Mapping>,
}

impl Ring {
    /// Maps about `buffers` buffers (the driver decides), queues them and starts the stream.
    ///
    /// # Errors
    /// As the driver gives them: EBUSY for a second reader, ENOSPC when the USB bus is full.
    pub fn start(node: VideoNode, buffers: u32) -> io::Result<Self> {
        let mut ring = Self {
            node,
            mappings: Vec::new(),
        };
        let granted = ring.ask_for_buffers(buffers)?;
        if granted == 0 {
            return Err(io::Error::from_raw_os_error(libc::ENOMEM));
        }
        for index in 0..granted {
            ring.map(index)?;
            ring.queue(index)?;
        }
        let mut kind = CAPTURE;
        ring.node.request(vidioc::VIDIOC_STREAMON, &mut kind)?;
        Ok(ring)
    }

    fn ask_for_buffers(&self, count: u32) -> io::Result<u32> {
        let mut ask = sys::v4l2_requestbuffers::zeroed();
        ask.count = count;
        ask.type_ = CAPTURE;
        ask.memory = MMAP;
        self.node.request(vidioc::VIDIOC_REQBUFS, &mut ask)?;
        Ok(ask.count)
    }

    fn descriptor(index: u32) -> sys::v4l2_buffer {
        let mut buffer = sys::v4l2_buffer::zeroed();
        buffer.index = index;
        buffer.type_ = CAPTURE;
        buffer.memory = MMAP;
        buffer
    }

    fn map(&mut self, index: u32) -> io::Result<()> {
        let mut buffer = Self::descriptor(index);
        self.node.request(vidioc::VIDIOC_QUERYBUF, &mut buffer)?;
        let length = buffer.length as usize;
        // SAFETY: for MMAP memory the driver answers with `offset`; the range it names is fresh,
        // of `length` bytes, and owned by the `Mapping` made here.
        #[allow(unsafe_code)]
        let start = unsafe {
            v4l::v4l2::mmap(
                std::ptr::null_mut(),
                length,
                libc::PROT_READ,
                libc::MAP_SHARED,
                self.node.fd(),
                libc::off_t::from(buffer.m.offset),
            )?
        };
        self.mappings.push(Mapping {
            start: start.cast(),
            length,
        });
        Ok(())
    }

    fn queue(&self, index: u32) -> io::Result<()> {
        let mut buffer = Self::descriptor(index);
        self.node.request(vidioc::VIDIOC_QBUF, &mut buffer)
    }

    /// Waits for a frame, at most `timeout`.
    ///
    /// # Errors
    /// As `poll` gives them; device errors are left to [`Self::take`].
    pub fn wait(&self, timeout: Duration) -> io::Result<Waited> {
        let mut descriptor = libc::pollfd {
            fd: self.node.fd(),
            events: libc::POLLIN,
            revents: 0,
        };
        let ms = i32::try_from(timeout.as_millis()).unwrap_or(i32::MAX);
        // SAFETY: one live pollfd, as the count says.
        #[allow(unsafe_code)]
        let ready = unsafe { libc::poll(&raw mut descriptor, 1, ms) };
        match ready {
            0 => Ok(Waited::Nothing),
            1.. => Ok(Waited::Ready),
            _ => match io::Error::last_os_error() {
                error if error.kind() == io::ErrorKind::Interrupted => Ok(Waited::Nothing),
                error => Err(error),
            },
        }
    }

    /// Takes the oldest full buffer.
    ///
    /// # Errors
    /// As the driver gives them: ENODEV after an unplug, EIO after a fatal stream error, EAGAIN
    /// when there is none.
    pub fn take(&mut self) -> io::Result<Taken> {
        let mut buffer = Self::descriptor(0);
        self.node.request(vidioc::VIDIOC_DQBUF, &mut buffer)?;
        let clock = buffer.flags & sys::V4L2_BUF_FLAG_TIMESTAMP_MASK;
        let stamp = buffer.timestamp;
        Ok(Taken {
            index: buffer.index,
            bytes_used: buffer.bytesused as usize,
            damaged: buffer.flags & sys::V4L2_BUF_FLAG_ERROR != 0,
            monotonic: clock == sys::V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC,
            sequence: buffer.sequence,
            stamp_ns: stamp
                .tv_sec
                .saturating_mul(1_000_000_000)
                .saturating_add(stamp.tv_usec.saturating_mul(1_000)),
        })
    }

    /// The bytes the driver filled in a taken buffer.
    #[must_use]
    pub fn bytes(&self, taken: &Taken) -> &[u8] {
        let Some(mapping) = self.mappings.get(taken.index as usize) else {
            return &[];
        };
        let length = taken.bytes_used.min(mapping.length);
        // SAFETY: the mapping lives as long as `self`, and the kernel does not write to a buffer
        // between DQBUF (which made `taken`) and QBUF (which consumes it).
        #[allow(unsafe_code)]
        unsafe {
            std::slice::from_raw_parts(mapping.start, length)
        }
    }

    /// Whole frames the driver holds for us. Of a broken stream they cannot be taken any more.
    #[must_use]
    pub fn finished(&self) -> u64 {
        let states = (0..self.mappings.len()).map_while(|index| {
            let mut buffer = Self::descriptor(u32::try_from(index).ok()?);
            let asked = self.node.request(vidioc::VIDIOC_QUERYBUF, &mut buffer);
            asked.ok().map(|()| buffer.flags)
        });
        let whole =
            states.filter(|flags| flags & DONE != 0 && flags & sys::V4L2_BUF_FLAG_ERROR == 0);
        whole.count() as u64
    }

    /// Gives a taken buffer back to the kernel.
    ///
    /// # Errors
    /// As the driver gives them.
    pub fn give_back(&mut self, taken: Taken) -> io::Result<()> {
        self.queue(taken.index)
    }
}

impl Drop for Ring {
    /// Stops the stream and frees the driver's buffers. An unplugged camera refuses both: there
    /// is nothing left to stop then.
    fn drop(&mut self) {
        let mut kind = CAPTURE;
        if let Err(error) = self.node.request(vidioc::VIDIOC_STREAMOFF, &mut kind) {
            tracing::debug!(%error, "the stream was not stopped");
        }
        self.mappings.clear();
        if let Err(error) = self.ask_for_buffers(0) {
            tracing::debug!(%error, "the driver's buffers were not freed");
        }
    }
}
