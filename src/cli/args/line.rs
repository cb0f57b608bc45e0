//! The whole command line: which flags go with a command and where.

use super::Arguments;
use clap::error::ErrorKind;
use clap::parser::ValueSource;
use clap::{CommandFactory, FromArgMatches};
use std::ffi::OsString;

/// Flags that mean the same before a command and after it.
const GLOBAL: [&str; 2] = ["quiet", "verbose"];

impl Arguments {
    /// Parses a command line. Flags of live capture take no command; `-q` and `-v` may stand
    /// before a command or after it, which clap's own rule for such flags would refuse.
    pub fn read<T: Into<OsString> + Clone>(
        words: impl IntoIterator<Item = T>,
    ) -> Result<Self, clap::Error> {
        let mut command = Self::command();
        let mut matches = command.try_get_matches_from_mut(words)?;
        if let Some(name) = matches.subcommand_name() {
            let typed = |id: &&clap::Id| {
                matches.value_source(id.as_str()) == Some(ValueSource::CommandLine)
                    && !GLOBAL.contains(&id.as_str())
            };
            let stray = command.get_arguments().find(|argument| {
                matches
                    .ids()
                    .filter(typed)
                    .any(|id| id == argument.get_id())
            });
            if let Some(argument) = stray {
                let what = format!("{argument} belongs to live capture, or behind `{name}`");
                return Err(command.error(ErrorKind::ArgumentConflict, what));
            }
        }
        let read = Self::from_arg_matches_mut(&mut matches);
        let read = read.map_err(|error| error.format(&mut command))?;
        if read.quiet && read.verbose > 0 {
            // on two sides of a command clap does not see them together
            let what = "-q says less and -v says more: give one of them";
            return Err(command.error(ErrorKind::ArgumentConflict, what));
        }
        Ok(read)
    }
}

#[cfg(test)]
mod tests {
    use super::super::Command;
    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        Arguments::command().debug_assert();
    }

    fn read(line: &str) -> Result<Arguments, clap::Error> {
        Arguments::read(line.split(' '))
    }

    #[test]
    fn global_flags_stand_on_either_side_of_a_command() {
        for (line, quiet, verbose) in [
            ("saint-live -q info x.mcap", true, 0),
            ("saint-live info -q x.mcap", true, 0),
            ("saint-live -vv info x.mcap", false, 2),
            ("saint-live info x.mcap -v", false, 1),
            ("saint-live info x.mcap", false, 0),
        ] {
            let arguments = read(line).unwrap();
            assert_eq!(
                (arguments.quiet, arguments.verbose),
                (quiet, verbose),
                "{line}"
            );
            assert!(matches!(arguments.command, Some(Command::Info(_))));
        }
        for line in ["saint-live -q -v info x", "saint-live -q info x -v"] {
            let error = read(line).unwrap_err();
            assert_eq!(error.kind(), ErrorKind::ArgumentConflict, "{line}");
        }
    }

    #[test]
    fn flags_of_live_capture_take_no_command() {
        for line in [
            "saint-live --device 0 info x",
            "saint-live --lossless replay x",
        ] {
            let error = read(line).unwrap_err();
            assert_eq!(error.kind(), ErrorKind::ArgumentConflict, "{line}");
        }
        let live = read("saint-live --device 0 --lossless").unwrap();
        assert!(live.command.is_none() && live.live.engine.lossless);
    }
}
