//! The program's own fits and codec behind the traits of the stages.

use super::StageError;
use super::packet::{CodingReport, ModelReport};
use super::stages::{Encode, Model};
use crate::codec::{EncodedFrame, Encoder};
use crate::contact_map::labels::SaintFrame;
use crate::fit::framewise::FrameFit;
use crate::fit::live::{FitReport, Modeler};
use crate::frame::DepthFrame;

impl From<FitReport> for ModelReport {
    fn from(fit: FitReport) -> Self {
        Self {
            points: fit.valid_pixels,
            explained: fit.explained_pixels,
            spheres: fit.spheres,
            warm: fit.warm_pixels,
            degraded: fit.degraded,
            hurried: false,
        }
    }
}

impl Model for Modeler {
    fn model(
        &mut self,
        depth: &DepthFrame,
        saint: &mut SaintFrame,
        deadline: &dyn Fn() -> bool,
    ) -> Result<ModelReport, StageError> {
        // the inherent method, not this one
        Ok(Self::model(self, depth, saint, deadline).into())
    }

    fn start_over(&mut self) -> bool {
        self.reset();
        true
    }
}

impl Model for FrameFit {
    fn model(
        &mut self,
        depth: &DepthFrame,
        saint: &mut SaintFrame,
        deadline: &dyn Fn() -> bool,
    ) -> Result<ModelReport, StageError> {
        Ok(Self::model(self, depth, saint, deadline)?.into())
    }
}

impl Encode for Encoder {
    fn encode(
        &mut self,
        depth: &DepthFrame,
        saint: &SaintFrame,
        modelled: &ModelReport,
        encoded: &mut EncodedFrame,
    ) -> Result<CodingReport, StageError> {
        let report = if modelled.hurried {
            self.encode_plainly(depth, saint, encoded)?
        } else {
            Self::encode(self, depth, saint, modelled.degraded, encoded)?
        };
        Ok(CodingReport {
            spent: report.spent(),
            ..CodingReport::default()
        })
    }

    fn start_over(&mut self) -> bool {
        self.request_key();
        true
    }
}
