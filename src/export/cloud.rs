//! A frame whose contact map is polar: points without a grid.

use super::{Point, sphere_of};
use crate::contact_map::labels::INVALID;
use crate::contact_map::merged::ClaimMap;
use crate::fit::sphere::Sphere;
use crate::frame::{Camera, FrameTime};
use glam::DVec3;

/// A polar frame as the decoder gives it.
#[derive(Clone, Copy, Debug)]
pub struct ExportCloud<'a> {
    /// The source's frame number.
    pub sequence: u64,
    /// When the frame was taken.
    pub time: FrameTime,
    /// Spheres and the cells they claim, in the optical frame.
    pub map: &'a ClaimMap,
}

impl<'a> ExportCloud<'a> {
    /// One point for each claim, by Eq. 1 of the paper, sphere by sphere; metres, optical frame.
    /// A sphere's number beyond those of a frame is left out.
    pub fn points(&self) -> impl Iterator<Item = Point> + use<'a> {
        let map = self.map;
        map.patches.iter().enumerate().flat_map(move |(s, patch)| {
            let grid = patch.grid(f64::from(map.step_m));
            let sphere = u16::try_from(s).ok().and_then(sphere_of);
            map.claims(s).iter().map(move |&cell| Point {
                position: (grid.point(cell) + map.origin).as_vec3(),
                sphere,
            })
        })
    }

    /// Number, centre and radius (metres) of each sphere that claims a cell.
    pub fn spheres(&self) -> impl Iterator<Item = (u16, DVec3, f64)> + Clone + use<'a> {
        let map = self.map;
        let used = move |s: &usize| !map.claims(*s).is_empty();
        (0..map.patches.len()).filter(used).filter_map(move |s| {
            let (center, radius) = map.patches[s].center_radius();
            Some((u16::try_from(s).ok()?, center + map.origin, radius))
        })
    }

    /// Draws the points as the camera sees them, for the eye: `depth_m` (0 = nothing) and
    /// `labels` get one value per pixel, the nearest point wins, a pixel between points stays
    /// empty. `spheres` get their slots.
    pub fn project(
        &self,
        camera: &Camera,
        depth_m: &mut Vec<f32>,
        labels: &mut Vec<u16>,
        spheres: &mut Vec<Option<Sphere>>,
    ) {
        let lens = camera.intrinsics;
        let (width, height) = (f64::from(camera.width), f64::from(camera.height));
        depth_m.clear();
        depth_m.resize(camera.pixels(), 0.0);
        labels.clear();
        labels.resize(camera.pixels(), INVALID);
        for point in self.points() {
            let [x, y, z] = point.position.as_dvec3().to_array();
            if !(z > 0.0 && z.is_finite()) {
                continue;
            }
            let (u, v) = (
                (x / z * lens.fx + lens.cx).round(),
                (y / z * lens.fy + lens.cy).round(),
            );
            if !(u >= 0.0 && v >= 0.0 && u < width && v < height) {
                continue;
            }
            let pixel = v as usize * camera.width as usize + u as usize;
            let z = z as f32;
            if depth_m[pixel] == 0.0 || z < depth_m[pixel] {
                depth_m[pixel] = z;
                labels[pixel] = point
                    .sphere
                    .unwrap_or(crate::contact_map::labels::NO_SPHERE);
            }
        }
        spheres.clear();
        let slots = self.map.patches.iter().enumerate();
        spheres.extend(slots.map(|(s, patch)| {
            let seen = patch.sphere().translated(self.map.origin).seen_from_zero();
            seen.filter(|_| !self.map.claims(s).is_empty())
        }));
    }
}
