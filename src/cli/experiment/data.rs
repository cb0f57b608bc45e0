//! Data of an experiment: clouds and depth frames as the user names them, or stand-ins.

use crate::cli::args::ExperimentArgs;
use crate::cli::failure::Failure;
use crate::cli::source::{self, InputOptions};
use saint_live::capture::Next;
use saint_live::cloud::{Cloud, CloudFormat};
use saint_live::experiment::subject::{synthetic_frames, synthetic_objects};
use saint_live::experiment::{DepthFrames, Subject};
use saint_live::frame::DepthFrame;
use std::path::Path;

/// Frames of a sequence that train and judge a loss, where no number is given.
const LOSS_FRAMES: u64 = 12;
/// Frames of the synthetic sensor and their size, where no data are given.
const SYNTHETIC_FRAMES: (usize, (u32, u32)) = (8, (320, 240));
/// Points of a synthetic object, at most.
const SYNTHETIC_POINTS: usize = 8000;

/// Clouds, and frames as clouds.
pub fn subjects(args: &ExperimentArgs) -> Result<Vec<Subject>, Failure> {
    let (contact, most) = (args.contact_distance, args.max_points);
    let mut subjects = Vec::new();
    let as_clouds = |sequence: &DepthFrames, subjects: &mut Vec<Subject>| -> Result<(), Failure> {
        for frame in &sequence.frames {
            let name = format!("{} #{}", sequence.name, frame.sequence);
            subjects.push(Subject::frame(
                &name,
                &sequence.camera,
                frame,
                contact,
                most,
            )?);
        }
        Ok(())
    };
    for path in &args.data {
        if is_cloud(path) {
            let cloud = Cloud::read(path)?;
            let unit = args.unit.or(cloud.stated_unit).unwrap_or_default();
            let points = cloud.into_metres(unit);
            subjects.push(Subject::cloud(&name(path), &points, contact, most)?);
        } else {
            as_clouds(
                &sequence(path, args, args.frames.unwrap_or(1))?,
                &mut subjects,
            )?;
        }
    }
    if args.data.is_empty() {
        for (name, points) in synthetic_objects(SYNTHETIC_POINTS.min(most), 1) {
            subjects.push(Subject::cloud(name, &points, contact, most)?);
        }
        as_clouds(&synthetic_frames(1, SYNTHETIC_FRAMES.1)?, &mut subjects)?;
    }
    Ok(subjects)
}

/// Frames of depth cameras.
pub fn sequences(args: &ExperimentArgs) -> Result<Vec<DepthFrames>, Failure> {
    if args.data.is_empty() {
        let count = args.frames.map_or(SYNTHETIC_FRAMES.0, |n| n as usize);
        let frames = synthetic_frames(count, SYNTHETIC_FRAMES.1)?;
        return Ok(vec![DepthFrames {
            contact: args.contact_distance.unwrap_or(frames.contact),
            ..frames
        }]);
    }
    let frames = args.frames.unwrap_or(LOSS_FRAMES);
    args.data
        .iter()
        .map(|path| match is_cloud(path) {
            true => Err(Failure::usage(format_args!(
                "{} is a cloud; this experiment needs depth frames (a folder of EXR or PNG files, a recording)",
                path.display()
            ))),
            false => sequence(path, args, frames),
        })
        .collect()
}

/// `count` frames, evenly spread over what there is.
fn sequence(path: &Path, args: &ExperimentArgs, count: u64) -> Result<DepthFrames, Failure> {
    let options = InputOptions {
        camera: args.camera.clone(),
        ..InputOptions::default()
    };
    let mut source = source::recorded(path, &options)?;
    let there = source.len_hint().unwrap_or(count).max(1);
    let wanted: Vec<u64> = (0..count.min(there))
        .map(|i| (2 * i + 1) * there / (2 * count.min(there)))
        .collect();
    let mut frames = Vec::new();
    let mut frame = DepthFrame::default();
    let mut number = 0;
    while frames.len() < wanted.len() {
        match source.next(&mut frame)? {
            Next::Frame => {
                if wanted.contains(&number) {
                    frames.push(frame.clone());
                }
                number += 1;
            }
            Next::Waiting(_) => {}
            Next::End => break,
        }
    }
    Ok(DepthFrames {
        name: name(path),
        camera: source.camera().clone(),
        contact: args.contact_distance.unwrap_or_default(),
        frames,
        truth_m: None,
    })
}

fn name(path: &Path) -> String {
    let stem = if path.is_dir() {
        path.file_name()
    } else {
        path.file_stem()
    };
    stem.map_or_else(
        || path.display().to_string(),
        |s| s.to_string_lossy().into_owned(),
    )
}

fn is_cloud(path: &Path) -> bool {
    CloudFormat::named(path).is_some()
}
