//! Bindings of `<linux/videodev2.h>`, generated ahead of time for 64-bit Linux.
//!
//! The structures of the V4L2 interface have one layout on every 64-bit Linux target
//! (LP64, natural alignment); the generated file asserts each size and offset at compile time.
#![allow(non_camel_case_types, non_snake_case, non_upper_case_globals, clippy::all)]

#[cfg(not(all(target_os = "linux", target_pointer_width = "64")))]
compile_error!("saint-live reads V4L2 devices: it builds on 64-bit Linux only");

include!("bindings.rs");

/// C's `time_t`, which `v4l` expects here.
pub type time_t = std::os::raw::c_long;
