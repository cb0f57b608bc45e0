//! The random scheme (paper 3.1, 3.2, 4.1): the sphere that most points touch, of many through
//! randomly drawn points; its contacts are taken out; again, until about 0.1 % remain.

use super::cloud::{CloudModel, FitParameters, UNASSIGNED, UNEXPLAINED_SHARE};
use super::cover::Cover;
use super::draw::Draw;
use super::fewer::fewer;
use super::ordered::Ordered;
use super::remaining::Remaining;
use super::search::SphereSearch;
use crate::partition::points::LocalPoints;

/// The random scheme and its buffers, kept from cloud to cloud.
#[derive(Debug, Default)]
pub struct RandomFit {
    points: Ordered,
    remaining: Remaining,
    search: SphereSearch,
}

impl RandomFit {
    /// Fits spheres to the whole cloud as to one object (paper 3.2: "to the entire object for a
    /// single object"). Same points, parameters and seed: same model.
    ///
    /// Every assigned point is within contact distance of its sphere up to the rounding of
    /// single precision. Stops at 0.1 % unexplained, at `max_spheres`, or where the points left
    /// span no surface.
    #[must_use]
    pub fn fit(&mut self, points: &LocalPoints, parameters: &FitParameters) -> CloudModel {
        let origin = points.origin;
        self.points.fill(points, &parameters.contact_distance);
        let points = &self.points;
        self.remaining.refill(points.len());
        let allowed = (points.len() as f64 * UNEXPLAINED_SHARE) as usize;
        let mut draw = Draw::new(parameters.seed);
        self.search.begin();
        let mut cover = Cover::new(points.len());
        while self.remaining.len() > allowed && cover.spheres.len() < parameters.max_spheres {
            let found = cover.spheres.len();
            let Some(sphere) = self.search.best(points, &self.remaining, found, &mut draw) else {
                break;
            };
            let members = points.touching(&sphere);
            if self.remaining.remove(&members) == 0 {
                break;
            }
            cover.push(sphere, members);
        }
        if self.remaining.len() <= allowed {
            cover.prune(allowed);
            fewer(&mut cover, points, allowed, &mut draw);
        }
        cover.settle(points);
        let mut model = CloudModel {
            origin,
            assignment: vec![UNASSIGNED; points.len()],
            ..CloudModel::default()
        };
        cover.assign(points, &mut model.assignment);
        model.spheres = cover.spheres;
        model.order_and_limit(parameters.max_spheres);
        model
    }
}
