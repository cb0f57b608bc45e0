//! An input that begins again at its end: frame numbers and times go on.

use super::{Camera, CaptureError, ColorFrame, DepthFrame, FrameSource, Next, SourceLosses};

/// Opens the input again.
pub type Reopen = Box<dyn FnMut() -> Result<Box<dyn FrameSource>, CaptureError> + Send>;

/// A source that never ends (unless it is empty).
pub struct Repeated {
    inner: Box<dyn FrameSource>,
    reopen: Reopen,
    period_ns: i64,
    sequence_offset: u64,
    time_offset_ns: i64,
    first: Option<(u64, i64)>,
    last: (u64, i64),
    lost_before: SourceLosses,
}

impl Repeated {
    /// Repeats `inner`; `period_ns` is put between two rounds of a single frame.
    pub fn new(inner: Box<dyn FrameSource>, reopen: Reopen, period_ns: i64) -> Self {
        Self {
            inner,
            reopen,
            period_ns,
            sequence_offset: 0,
            time_offset_ns: 0,
            first: None,
            last: (0, 0),
            lost_before: SourceLosses::default(),
        }
    }

    fn begin_again(&mut self) -> Result<(), CaptureError> {
        let lost = self.losses();
        self.inner = (self.reopen)()?;
        self.lost_before = lost;
        Ok(())
    }
}

impl FrameSource for Repeated {
    fn camera(&self) -> &Camera {
        self.inner.camera()
    }

    fn is_live(&self) -> bool {
        false
    }

    fn next(&mut self, frame: &mut DepthFrame) -> Result<Next, CaptureError> {
        let mut next = self.inner.next(frame)?;
        if next == Next::End
            && let Some((first_sequence, first_ns)) = self.first
        {
            let (last_sequence, last_ns) = self.last;
            self.begin_again()?;
            self.sequence_offset = last_sequence + 1 - first_sequence;
            self.time_offset_ns = last_ns + self.period_ns - first_ns;
            next = self.inner.next(frame)?;
        }
        if next == Next::Frame {
            let own = (frame.sequence, frame.time.device_ns);
            self.first.get_or_insert(own);
            let now = (own.0 + self.sequence_offset, own.1 + self.time_offset_ns);
            let step = now.1 - self.last.1;
            if now.0 == self.last.0 + 1 && step > 0 {
                self.period_ns = step;
            }
            self.last = now;
            (frame.sequence, frame.time.device_ns) = now;
        }
        Ok(next)
    }

    fn take_color(&mut self) -> Option<ColorFrame> {
        self.inner.take_color()
    }

    fn losses(&self) -> SourceLosses {
        let now = self.inner.losses();
        SourceLosses {
            sensor_gap: now.sensor_gap + self.lost_before.sensor_gap,
            damaged: now.damaged + self.lost_before.damaged,
            stall: now.stall + self.lost_before.stall,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use saint_live::capture::synthetic::{SyntheticOptions, SyntheticSource};

    fn three_frames() -> Box<dyn FrameSource> {
        let options =
            SyntheticOptions::parse("room,size=16x12,frames=3,paced=false,fps=10").unwrap();
        Box::new(SyntheticSource::open(options).unwrap())
    }

    #[test]
    fn numbers_and_times_go_on() {
        let mut source = Repeated::new(three_frames(), Box::new(|| Ok(three_frames())), 1);
        let mut frame = DepthFrame::default();
        let mut depths = Vec::new();
        for n in 0..9 {
            assert_eq!(source.next(&mut frame).unwrap(), Next::Frame);
            assert_eq!(frame.sequence, n);
            assert_eq!(frame.time.device_ns, n as i64 * 100_000_000);
            depths.push(frame.depth.clone());
        }
        assert_eq!(depths[0..3], depths[3..6]);
        assert_ne!(depths[0], depths[1]);
    }
}
