//! From a frame's contact map on the sensor's grid to the polar maps of its spheres.

use super::labels::SaintFrame;
use super::merged::ClaimMap;
use crate::deproject::{Rays, Validity};
use crate::fit::cloud::{CloudModel, CloudSphere, UNASSIGNED};
use crate::fit::contact_distance::ContactDistance;
use crate::fit::framewise::FrameCloud;
use crate::frame::{Camera, DepthFrame};
use crate::partition::points::TooManyPoints;

/// Cells of a polar map for a contact distance, metres of arc.
///
/// Paper 3.2 gives the map resolution `mr` as a number of cells over the angles of every sphere,
/// so a cell is 3 mm on an egg and 60 m on a tabletop of radius 10 km at `mr` = 512. Ours is a
/// length, the same on every sphere (for a sphere of radius R it is `mr = πR / step`). Half the
/// contact distance keeps a cell's rounding (at most 0.71 steps) below the contact distance, and
/// below the spacing of a VGA camera's pixels beyond a metre.
#[must_use]
pub fn default_step_m(contact: &ContactDistance) -> f64 {
    0.5 * contact.floor_m
}

/// Makes polar maps of the frames of one camera, with its buffers.
#[derive(Debug)]
pub struct PolarMapper {
    rays: Rays,
    validity: Validity,
    step_m: f32,
    cloud: FrameCloud,
    model: CloudModel,
}

impl PolarMapper {
    /// For frames of `camera`, at cells of `step_m` metres (above 0).
    #[must_use]
    pub fn new(camera: &Camera, step_m: f32) -> Self {
        Self {
            rays: Rays::new(camera),
            validity: Validity::new(camera),
            step_m,
            cloud: FrameCloud::default(),
            model: CloudModel::default(),
        }
    }

    /// The polar maps of a modelled frame, and how many of its measurements they lack: those of
    /// no sphere. A sphere's number is its slot; an empty slot claims nothing. A measurement is
    /// given back within contact distance and 0.71 cells; several in one cell come back as one.
    ///
    /// # Errors
    /// More pixels than a `u32` can number.
    pub fn map(
        &mut self,
        frame: &DepthFrame,
        saint: &SaintFrame,
    ) -> Result<(ClaimMap, u32), TooManyPoints> {
        self.cloud.refill(&self.rays, &self.validity, frame)?;
        let points = &self.cloud.points;
        let spheres = &mut self.model.spheres;
        spheres.clear();
        let mut real = Vec::with_capacity(saint.spheres.len());
        for slot in &saint.spheres {
            let sphere = slot.as_ref().and_then(CloudSphere::from_seen);
            real.push(sphere.is_some());
            // a stand-in that no point is assigned to
            let plane = CloudSphere {
                curvature: 0.0,
                normal: glam::DVec3::Z,
                offset: 0.0,
            };
            spheres.push(sphere.map_or(plane, |s| s.translated(-points.origin)));
        }
        self.model.origin = points.origin;
        self.model.assignment.clear();
        let mut lost = 0;
        for &pixel in &self.cloud.pixels {
            let (x, y) = (
                pixel as usize % self.rays.width,
                pixel as usize / self.rays.width,
            );
            let label = saint.contacts.label(self.rays.width, x, y);
            let known = real.get(usize::from(label)).copied().unwrap_or(false);
            lost += u32::from(!known);
            let sphere = if known { u32::from(label) } else { UNASSIGNED };
            self.model.assignment.push(sphere);
        }
        let (map, outside) = ClaimMap::new(points, &self.model, self.step_m);
        Ok((map, lost + outside as u32))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::capture::FrameSource;
    use crate::capture::synthetic::{Scene, SyntheticOptions, SyntheticSource};
    use crate::codec::polar;
    use crate::contact_map::labels::NO_SPHERE;
    use crate::fit::live::{FitOptions, Modeler};
    use glam::DVec3;

    #[test]
    fn every_claimed_point_comes_back_within_contact_and_cell() {
        let options = SyntheticOptions {
            width: 160,
            height: 120,
            ..SyntheticOptions::unpaced(Scene::Room)
        };
        let mut source = SyntheticSource::open(options).unwrap();
        let camera = source.camera().clone();
        let mut frame = DepthFrame::default();
        source.render(0, &mut frame.depth);
        let fit = FitOptions::default();
        let mut saint = SaintFrame::default();
        let report = Modeler::new(&camera, &fit).model(&frame, &mut saint, &|| false);
        let step_m = default_step_m(&fit.contact_distance) as f32;
        let mut mapper = PolarMapper::new(&camera, step_m);
        let (map, lost) = mapper.map(&frame, &saint).unwrap();
        assert_eq!(lost, report.valid_pixels - report.explained_pixels);
        let mut bytes = Vec::new();
        polar::encode(&map, &mut bytes).unwrap();
        let back = polar::decode(&bytes).unwrap();
        let rebuilt = back.rebuild();
        let rays = Rays::new(&camera);
        for (pixel, label) in saint.labels(160, 120).into_iter().enumerate() {
            if label >= NO_SPHERE {
                continue;
            }
            let z = f64::from(frame.depth[pixel]) * camera.depth_unit_m;
            let p = rays.point(pixel % 160, pixel / 160, z);
            let own = back.starts[usize::from(label)] as usize
                ..back.starts[usize::from(label) + 1] as usize;
            let nearest = rebuilt[own]
                .iter()
                .map(|r| (*r + back.origin).distance(p))
                .fold(f64::MAX, f64::min);
            let bound = fit.contact_distance.at(z) + 0.7072 * f64::from(step_m) + 1e-4;
            assert!(
                nearest <= bound,
                "pixel {pixel}: {nearest} m, at most {bound}"
            );
        }
        // nothing is claimed but by points
        assert!(rebuilt.len() <= report.explained_pixels as usize);
        assert!(
            rebuilt
                .iter()
                .all(|p| (*p + map.origin).distance(DVec3::ZERO) < 20.0)
        );
    }
}
