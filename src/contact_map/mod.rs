//! The contact map: which sphere each grid cell touches (paper 3.1, 3.2).

pub mod assign;
pub mod contact;
pub mod labels;
pub mod merged;
pub mod polar;
pub mod polar_frame;
