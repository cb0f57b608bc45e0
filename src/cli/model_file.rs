//! What `info` and `export` do with a model file.

use super::args::{ExportArg, ExportArgs};
use super::failure::{Failure, Kind};
use super::message;
use super::model::{line, print_json};
use saint_live::export::{ExportError, Format};
use saint_live::model::file::ModelFile;
use saint_live::model::{Scene, export};
use saint_live::recording::Target;
use serde::Serialize;
use std::fmt::Write as _;
use std::path::Path;

/// `info` of a model file.
pub fn info(path: &Path, json: bool) -> Result<(), Failure> {
    let model = ModelFile::read(path)?;
    for part in &model.parts {
        model.decode(part)?;
    }
    if json {
        #[derive(Serialize)]
        struct Info<'a> {
            path: String,
            bytes: u64,
            kind: &'static str,
            damaged: &'a Option<String>,
            #[serde(flatten)]
            scene: &'a Scene,
        }
        print_json(&Info {
            path: path.display().to_string(),
            bytes: model.bytes,
            kind: "model",
            damaged: &model.damage,
            scene: &model.scene,
        })?;
    } else {
        let scene = &model.scene;
        let mut text = String::new();
        // writing to a String cannot fail
        let _ = writeln!(
            text,
            "{}: {} bytes, model, {}",
            path.display(),
            model.bytes,
            scene.generator
        );
        let _ = writeln!(
            text,
            "fit       {} scheme, seed {}",
            scene.scheme, scene.seed
        );
        for object in &scene.objects {
            let [x, y, z] = object.extent_m;
            let _ = writeln!(
                text,
                "object    {}: {} points, {x:.4} x {y:.4} x {z:.4} m, from {} in {}",
                object.name, object.points, object.source, object.unit
            );
        }
        for part in &model.parts {
            let _ = writeln!(text, "part      {}", line(scene, part));
        }
        super::write_data(text.as_bytes())?;
    }
    match &model.damage {
        None => Ok(()),
        Some(what) => Err(damaged(path, &model, what)),
    }
}

fn damaged(path: &Path, model: &ModelFile, what: &str) -> Failure {
    Failure::new(
        Kind::Input,
        format_args!(
            "{}: damaged after {} of {} parts: {what}; everything that could be read was used",
            path.display(),
            model.parts.len(),
            model.scene.parts.len()
        ),
    )
}

/// `export` of a model file: one file with the points or spheres of one scale.
pub fn export(args: &ExportArgs, quiet: bool) -> Result<(), Failure> {
    let format = match args.to {
        ExportArg::Ply => Format::Ply,
        ExportArg::Spheres => Format::Spheres,
        ExportArg::Pcd => Format::Pcd,
        ExportArg::Npz => Format::Npz,
        ExportArg::Exr | ExportArg::Png | ExportArg::Png16 => {
            return Err(Failure::usage(format_args!(
                "{} is a model: its points have no grid of pixels; export to ply, pcd, spheres or npz",
                args.file.display()
            )));
        }
    };
    if args.from > 0 || args.frames.is_some() {
        return Err(Failure::usage(format_args!(
            "{} is a model and has no frames; choose with --scale and --object",
            args.file.display()
        )));
    }
    let model = ModelFile::read(&args.file)?;
    let chosen = model.select(args.scale, args.object.as_deref())?;
    let decoded = chosen.iter().map(|part| model.decode(part));
    let decoded = decoded.collect::<Result<Vec<_>, _>>()?;
    let objects = chosen.iter().map(|part| part.info.object);
    let placed: Vec<_> = objects.zip(&decoded).collect();
    let file = args.output.extension();
    let path = if file.is_some_and(|e| e.eq_ignore_ascii_case(format.extension()))
        && !args.output.is_dir()
    {
        args.output.clone()
    } else {
        // a folder, as for recordings
        std::fs::create_dir_all(&args.output)
            .map_err(|source| write_failed(&args.output, source))?;
        let name = args.object.as_deref().unwrap_or("model");
        args.output.join(format!("{name}.{}", format.extension()))
    };
    let bytes = match format {
        Format::Spheres => export::ply_spheres(&placed),
        Format::Pcd => export::pcd_points(&placed).map_err(|e| Failure::new(Kind::Failure, e))?,
        Format::Npz => export::npz_points(&placed).map_err(|e| Failure::new(Kind::Failure, e))?,
        _ => export::ply_points(&placed),
    };
    Target::File {
        path: path.clone(),
        overwrite: args.overwrite,
    }
    .put(&bytes)?;
    if !quiet {
        message::say(&format!("wrote {}: {} bytes", path.display(), bytes.len()));
    }
    match &model.damage {
        None => Ok(()),
        Some(what) => Err(damaged(&args.file, &model, what)),
    }
}

fn write_failed(path: &Path, source: std::io::Error) -> Failure {
    ExportError::Write {
        path: path.to_owned(),
        files: 0,
        source,
    }
    .into()
}
