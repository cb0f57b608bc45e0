//! `repair`: what is whole in a cut or damaged recording, as a new file.

use super::args::RepairArgs;
use super::failure::{Failure, Kind};
use super::message;
use saint_live::recording::{Target, repair};

/// Writes the new file and says what was kept and what was lost.
pub fn run(args: &RepairArgs, quiet: bool) -> Result<(), Failure> {
    let (file, output) = (args.file.display(), args.output.display());
    if super::run::is_same_file(&args.output, &args.file) {
        return Err(Failure::usage(format_args!(
            "{file} is input and output at once; give -o another name"
        )));
    }
    let target = Target::File {
        path: args.output.clone(),
        overwrite: args.overwrite,
    };
    let report = repair(&args.file, target)?;
    if args.json {
        let mut text =
            serde_json::to_string(&report).map_err(|e| Failure::new(Kind::Failure, e))?;
        text.push('\n');
        super::write_data(text.as_bytes())?;
    }
    if !quiet {
        for damage in &report.damaged {
            message::say(&format!(
                "{file}: at byte {}, after {} kept frames: {}",
                damage.offset, damage.frame, damage.what
            ));
        }
        let state = match (report.cut, report.damaged.is_empty()) {
            (true, _) => "was cut: what followed its last whole frame is lost",
            (_, true) => "had nothing to repair",
            (_, false) => "was damaged",
        };
        message::say(&format!(
            "{file} {state}; wrote {output}: {} frames kept, {} lost, {} bytes",
            report.frames_kept, report.frames_lost, report.bytes
        ));
    }
    if report.frames_kept == 0 && !report.damaged.is_empty() {
        return Err(Failure::new(
            Kind::Input,
            format_args!("{file}: no frame could be saved; {output} holds the camera alone"),
        ));
    }
    Ok(())
}
