//! Files of other writers.
