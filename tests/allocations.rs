//! The live path allocates nothing per frame once its buffers have grown.
//!
//! One test only: the allocator below counts for the thread that asks for it, and the worker pool
//! is that thread alone.

#![allow(
    clippy::unwrap_used,
    unsafe_code,
    reason = "a test fails by panicking; a global allocator is unsafe to write"
)]

use saint_live::capture::FrameSource;
use saint_live::capture::synthetic::{Scene, SyntheticOptions, SyntheticSource};
use saint_live::codec::{CodecOptions, EncodedFrame, Encoder};
use saint_live::contact_map::labels::SaintFrame;
use saint_live::fit::live::{FitOptions, Modeler};
use saint_live::frame::DepthFrame;
use std::alloc::{GlobalAlloc, Layout, System};
use std::backtrace::Backtrace;
use std::cell::{Cell, RefCell};

/// Frames that let buffers grow, and frames counted. The counted ones span two key frames.
const WARM_UP: u64 = 10;
const COUNTED: u64 = 70;
const KEYFRAME_EVERY: u32 = 30;

thread_local! {
    static COUNTING: Cell<bool> = const { Cell::new(false) };
    static ALLOCATIONS: Cell<u64> = const { Cell::new(0) };
    /// Where the first few came from.
    static WHERE: RefCell<Vec<Backtrace>> = const { RefCell::new(Vec::new()) };
}

/// The system allocator, counting calls that give out memory.
struct Counting;

/// Counts one call, where this thread counts.
fn note() {
    // the backtrace allocates too
    if COUNTING.replace(false) {
        ALLOCATIONS.set(ALLOCATIONS.get() + 1);
        WHERE.with_borrow_mut(|traces| {
            if traces.len() < 3 {
                traces.push(Backtrace::force_capture());
            }
        });
        COUNTING.set(true);
    }
}

// SAFETY: every call is passed on unchanged to the system allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        note();
        // SAFETY: the caller's promises are passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        note();
        // SAFETY: the caller's promises are passed on.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, memory: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        note();
        // SAFETY: the caller's promises are passed on.
        unsafe { System.realloc(memory, layout, size) }
    }

    unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
        // SAFETY: the caller's promises are passed on.
        unsafe { System.dealloc(memory, layout) }
    }
}

#[global_allocator]
static COUNTER: Counting = Counting;

/// Allocations while `work` runs, on this thread.
fn allocations(work: impl FnOnce()) -> u64 {
    let before = ALLOCATIONS.get();
    COUNTING.set(true);
    work();
    COUNTING.set(false);
    ALLOCATIONS.get() - before
}

#[test]
fn the_live_path_allocates_nothing_in_the_steady_state() {
    assert_eq!(
        allocations(|| drop(std::hint::black_box(Vec::<u8>::with_capacity(9)))),
        1,
        "the allocator does not count"
    );
    WHERE.take();
    rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .use_current_thread()
        .build_global()
        .unwrap();
    let options = SyntheticOptions {
        width: 320,
        height: 240,
        ..SyntheticOptions::unpaced(Scene::Room)
    };
    let mut source = SyntheticSource::open(options).unwrap();
    let camera = source.camera().clone();
    let fit = FitOptions::default();
    let mut modeler = Modeler::new(&camera, &fit);
    let codec = CodecOptions::fitted(fit.contact_distance, KEYFRAME_EVERY);
    let mut encoder = Encoder::new(&camera, codec).unwrap();
    let (mut frame, mut saint) = (DepthFrame::default(), SaintFrame::default());
    let mut encoded = EncodedFrame::default();
    let (mut model, mut encode) = (Vec::new(), Vec::new());
    for n in 0..WARM_UP + COUNTED {
        source.render(n, &mut frame.depth);
        frame.sequence = n;
        if n == WARM_UP {
            model.clear();
            encode.clear();
            WHERE.take();
        }
        model.push(allocations(|| {
            modeler.model(&frame, &mut saint, &|| false);
        }));
        encode.push(allocations(|| {
            encoder.encode(&frame, &saint, false, &mut encoded).unwrap();
        }));
        assert_eq!(encoded.key, n % u64::from(KEYFRAME_EVERY) == 0);
    }
    let total: u64 = model.iter().chain(&encode).sum();
    let traces: Vec<_> = WHERE.take().iter().map(ToString::to_string).collect();
    assert_eq!(
        total,
        0,
        "allocations by frame: model {model:?}, encode {encode:?}; the first of them:\n{}",
        traces.join("\n\n")
    );
}
