//! Who may open a node, and who has it open, as far as this user can see.

use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::Path;

/// What to do about a node this user may not open: names its group.
pub(in crate::capture) fn permission_remedy(device: &Path) -> String {
    let Ok(facts) = fs::metadata(device) else {
        return "join the group `video` (sudo usermod -aG video \"$USER\"), then log in again"
            .into();
    };
    let groups = fs::read_to_string("/etc/group").unwrap_or_default();
    let user = std::env::var("USER").unwrap_or_default();
    remedy(facts.gid(), facts.mode(), &groups, &user)
}

/// The remedy from a node's group and mode, the text of `/etc/group` and the user's name.
fn remedy(gid: u32, mode: u32, groups: &str, user: &str) -> String {
    let group = group_of(gid, groups);
    let name = group.map_or_else(|| gid.to_string(), |(name, _)| name.to_owned());
    let member = group.is_some_and(|(_, members)| members.split(',').any(|m| m == user));
    if mode & 0o060 != 0o060 {
        format!(
            "its group `{name}` may not read and write it either (mode {:04o}): ask for a udev \
             rule, or run `sudo chmod g+rw` on it and join the group",
            mode & 0o7777
        )
    } else if member && !user.is_empty() {
        format!("you are in its group `{name}`, but not in this session: log in again")
    } else {
        format!("join its group `{name}` (sudo usermod -aG {name} \"$USER\"), then log in again")
    }
}

/// Name and members of a group.
fn group_of(gid: u32, groups: &str) -> Option<(&str, &str)> {
    groups.lines().find_map(|line| {
        let mut fields = line.split(':');
        let name = fields.next()?;
        let number = fields.nth(1)?;
        (number.parse() == Ok(gid)).then(|| (name, fields.next().unwrap_or_default()))
    })
}

/// Programs that have a device open, as far as this user may see: `name (pid 123)`. Our own
/// process is left out.
pub(in crate::capture) fn holders(device: &Path) -> Vec<String> {
    let device = fs::canonicalize(device).unwrap_or_else(|_| device.into());
    let own = std::process::id().to_string();
    let mut names = Vec::new();
    for process in fs::read_dir("/proc").into_iter().flatten().flatten() {
        let pid = process.file_name().to_string_lossy().into_owned();
        if pid == own || !pid.bytes().all(|b| b.is_ascii_digit()) {
            continue;
        }
        let open_files = fs::read_dir(process.path().join("fd"));
        let holds = (open_files.into_iter().flatten().flatten())
            .any(|file| fs::read_link(file.path()).is_ok_and(|to| to == device));
        if holds {
            let name = fs::read_to_string(process.path().join("comm")).unwrap_or_default();
            names.push(format!("{} (pid {pid})", name.trim()));
        }
    }
    names.sort();
    names
}

#[cfg(test)]
mod tests {
    use super::*;

    const GROUPS: &str = "root:x:0:\nvideo:x:44:ann,bob\ncameras:x:1001:\nbroken\n";

    #[test]
    fn the_group_of_the_node_is_named() {
        let ask = |gid, mode, user| remedy(gid, mode, GROUPS, user);
        assert!(ask(44, 0o20_660, "eve").contains("usermod -aG video"));
        assert!(ask(1001, 0o20_660, "eve").contains("usermod -aG cameras"));
        assert!(ask(4242, 0o20_660, "eve").contains("`4242`"));
        assert!(ask(44, 0o20_660, "bob").contains("log in again"));
        assert!(!ask(44, 0o20_660, "bob").contains("usermod"));
        let closed = ask(0, 0o20_600, "eve");
        assert!(
            closed.contains("`root`") && closed.contains("0600"),
            "{closed}"
        );
    }

    #[test]
    fn a_program_that_holds_a_file_is_named() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let opened = fs::File::open(file.path()).unwrap();
        let mut child = std::process::Command::new("sleep")
            .arg("60")
            .stdin(opened)
            .spawn()
            .unwrap();
        let names = holders(file.path());
        child.kill().unwrap();
        child.wait().unwrap();
        let want = format!("sleep (pid {})", child.id());
        // between fork and exec the child still carries our name
        assert!(
            names.iter().any(|n| n.ends_with(&want["sleep".len()..])),
            "{names:?} without {want}"
        );
    }
}
