//! The colours a colour camera saw, brought to the pixels of depth frames.

use super::ExportFrame;
use super::color::{NO_SPHERE_COLOR, Rgb};
use crate::frame::ColorFrame;
use crate::rig::ColorCamera;
use glam::DVec3;
use image::{ImageReader, Limits, RgbImage};
use std::collections::VecDeque;
use std::io::Cursor;

/// An image farther from a depth frame than this is of another moment, ns.
const SAME_MOMENT_NS: i64 = 100_000_000;
/// Images kept to choose the nearest from.
const KEPT: usize = 8;
/// Largest image that is decoded, pixels a side.
const MAX_SIDE: u32 = 16_384;
/// A point this far behind what the colour camera sees in its place is hidden: the larger of a
/// length (metres) and a share of the distance.
const HIDDEN_M: f64 = 0.03;
const HIDDEN_SHARE: f64 = 0.02;

/// Projects depth pixels into the colour image nearest in time.
#[derive(Debug)]
pub struct Painter {
    camera: ColorCamera,
    images: VecDeque<ColorFrame>,
    /// The image decoded last and its time; `None` where it could not be decoded.
    decoded: Option<(i64, Option<RgbImage>)>,
    /// Nearest distance from the colour camera per block of its pixels, metres.
    nearest: Vec<f64>,
    colors: Vec<Rgb>,
}

impl Painter {
    /// A painter for a colour camera.
    #[must_use]
    pub fn new(camera: ColorCamera) -> Self {
        Self {
            camera,
            images: VecDeque::new(),
            decoded: None,
            nearest: Vec::new(),
            colors: Vec::new(),
        }
    }

    /// Takes an image; the last few are kept.
    pub fn offer(&mut self, image: ColorFrame) {
        if self.images.len() == KEPT {
            self.images.pop_front();
        }
        self.images.push_back(image);
    }

    /// A colour for each pixel of the frame, row-major; grey where nothing was measured and where
    /// the colour camera does not see the point. `None` where no image that can be decoded lies
    /// within a tenth of a second.
    pub fn paint(&mut self, frame: &ExportFrame<'_>) -> Option<&[Rgb]> {
        let time = frame.time.device_ns;
        let apart = |image: &&ColorFrame| image.time.device_ns.abs_diff(time);
        let image = self.images.iter().min_by_key(apart)?;
        let stamp = image.time.device_ns;
        if stamp.abs_diff(time) > SAME_MOMENT_NS as u64 {
            return None;
        }
        if self
            .decoded
            .as_ref()
            .is_none_or(|(known, _)| *known != stamp)
        {
            self.decoded = Some((stamp, decode(&image.data)));
        }
        let (_, Some(image)) = self.decoded.as_ref()? else {
            return None;
        };
        let size = image.dimensions();
        // a depth pixel covers a block of colour pixels: what is hidden is decided by blocks
        let block = (2 * size.0 / frame.camera.width.max(1)).max(1);
        let across = size.0.div_ceil(block) as usize;
        let place =
            |column: u32, row: u32| (row / block) as usize * across + (column / block) as usize;
        self.nearest.clear();
        self.nearest
            .resize(across * size.1.div_ceil(block) as usize, f64::INFINITY);
        let seen = |point: DVec3| self.camera.pixel_of(point, size);
        for point in frame.points() {
            if let Some((column, row, z)) = seen(point.position.as_dvec3()) {
                let least = &mut self.nearest[place(column, row)];
                *least = least.min(z);
            }
        }
        self.colors.clear();
        self.colors.resize(frame.depth_m.len(), NO_SPHERE_COLOR);
        let measured = frame.depth_m.iter().zip(&mut self.colors);
        let measured = measured.filter(|(z, _)| super::is_measured(**z));
        for (point, (_, color)) in frame.points().zip(measured) {
            if let Some((column, row, z)) = seen(point.position.as_dvec3())
                && z <= self.nearest[place(column, row)] + HIDDEN_M.max(HIDDEN_SHARE * z)
            {
                *color = image.get_pixel(column, row).0;
            }
        }
        Some(&self.colors)
    }
}

/// An image file's pixels; `None` where the bytes are damaged or too large.
fn decode(data: &[u8]) -> Option<RgbImage> {
    let mut reader = ImageReader::new(Cursor::new(data))
        .with_guessed_format()
        .ok()?;
    let mut limits = Limits::default();
    limits.max_image_width = Some(MAX_SIDE);
    limits.max_image_height = Some(MAX_SIDE);
    reader.limits(limits);
    Some(reader.decode().ok()?.into_rgb8())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::{Camera, FrameTime, Intrinsics};
    use crate::rig::Pose;
    use image::Rgb as Pixel;

    const LENS: Intrinsics = Intrinsics {
        fx: 8.0,
        fy: 8.0,
        cx: 3.5,
        cy: 2.5,
    };

    fn depth_camera() -> Camera {
        Camera {
            width: 8,
            height: 6,
            intrinsics: LENS,
            depth_unit_m: 0.001,
            invalid: vec![],
            depth_min_m: 0.0,
            depth_max_m: 10.0,
            fps: None,
            name: String::new(),
        }
    }

    fn painter(x: f64) -> Painter {
        Painter::new(ColorCamera {
            width: 8,
            height: 6,
            intrinsics: LENS,
            pose: Pose::from_quaternion([x, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]).unwrap(),
        })
    }

    /// Column and row as red and green.
    fn image(device_ns: i64, blue: u8) -> ColorFrame {
        let picture = RgbImage::from_fn(8, 6, |x, y| Pixel([x as u8, y as u8, blue]));
        let mut data = Cursor::new(Vec::new());
        picture
            .write_to(&mut data, image::ImageFormat::Png)
            .unwrap();
        ColorFrame {
            sequence: 0,
            time: FrameTime {
                device_ns,
                wall_ns: 0,
            },
            format: "png".into(),
            data: data.into_inner(),
        }
    }

    fn painted(painter: &mut Painter, depth_m: &[f32], device_ns: i64) -> Option<Vec<Rgb>> {
        let camera = depth_camera();
        let frame = ExportFrame {
            camera: &camera,
            sequence: 0,
            time: FrameTime {
                device_ns,
                wall_ns: 0,
            },
            depth_m,
            labels: &[0; 48],
            spheres: &[],
        };
        painter.paint(&frame).map(<[Rgb]>::to_vec)
    }

    #[test]
    fn each_pixel_gets_the_colour_of_the_image_nearest_in_time() {
        let mut same_place = painter(0.0);
        for (time, blue) in [(0, 1), (90_000_000, 2), (400_000_000, 3)] {
            same_place.offer(image(time, blue));
        }
        let mut depth = [2.0; 48];
        depth[9] = 0.0;
        let colors = painted(&mut same_place, &depth, 60_000_000).unwrap();
        for (at, color) in colors.iter().enumerate() {
            let want = match at {
                9 => NO_SPHERE_COLOR,
                _ => [(at % 8) as u8, (at / 8) as u8, 2],
            };
            assert_eq!(*color, want, "pixel {at}");
        }
        let colors = painted(&mut same_place, &depth, 500_000_000).unwrap();
        assert_eq!(colors[0][2], 3);
        assert_eq!(painted(&mut same_place, &depth, 250_000_000), None);
    }

    #[test]
    fn what_the_colour_camera_does_not_see_is_grey() {
        // the colour camera stands 0.25 m to the right: at 1 m the picture moves by 2 pixels
        let mut beside = painter(0.25);
        beside.offer(image(0, 0));
        let colors = painted(&mut beside, &[1.0; 48], 0).unwrap();
        assert_eq!(colors[8 + 1], NO_SPHERE_COLOR, "outside the image");
        assert_eq!(colors[8 + 2], [0, 1, 0]);
        assert_eq!(colors[8 + 7], [5, 1, 0]);
        // a near pixel hides the far ones that fall on its block of the colour image
        let mut depth = [4.0; 48];
        depth[8 + 5] = 1.0; // falls on column 3; far pixels move by half a pixel
        let colors = painted(&mut beside, &depth, 0).unwrap();
        assert_eq!(colors[8 + 5], [3, 1, 0]);
        assert!(
            (2..5).any(|x| colors[8 + x] == NO_SPHERE_COLOR),
            "{colors:?}"
        );
        assert_ne!(colors[16 + 7], NO_SPHERE_COLOR);
    }

    #[test]
    fn a_damaged_image_paints_nothing() {
        let mut painter = painter(0.0);
        let mut broken = image(0, 0);
        broken.data.truncate(20);
        painter.offer(broken);
        assert_eq!(painted(&mut painter, &[1.0; 48], 0), None);
        painter.offer(image(1, 7));
        assert!(painted(&mut painter, &[1.0; 48], 1).is_some());
    }
}
