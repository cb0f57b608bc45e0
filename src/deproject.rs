//! deproject
