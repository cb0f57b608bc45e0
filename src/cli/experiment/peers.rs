//! Compressors that are programs of their own: run where they are installed.

use glam::DVec3;
use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};

/// Size after `zstd -19`.
pub fn zstd(bytes: &[u8]) -> Option<usize> {
    let folder = Scratch::new()?;
    let path = folder.0.join("raw");
    fs::write(&path, bytes).ok()?;
    let output = Command::new("zstd")
        .args(["-19", "-q", "-c"])
        .arg(&path)
        .stdin(Stdio::null())
        .stderr(Stdio::null())
        .output()
        .ok()?;
    output.status.success().then_some(output.stdout.len())
}

/// Size after `draco_encoder` (point cloud, level 10) at `bits` per coordinate, and the points
/// that `draco_decoder` gives back.
pub fn draco(points: &[DVec3], bits: u32) -> Option<(usize, Vec<DVec3>)> {
    let folder = Scratch::new()?;
    let [raw, packed, back] = ["raw.ply", "packed.drc", "back.ply"].map(|n| folder.0.join(n));
    let mut ply = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\nend_header\n",
        points.len()
    )
    .into_bytes();
    for v in points.iter().flat_map(|p| p.as_vec3().to_array()) {
        ply.extend_from_slice(&v.to_le_bytes());
    }
    fs::write(&raw, ply).ok()?;
    let bits = bits.to_string();
    let options = ["-point_cloud", "-cl", "10", "-qp", &bits];
    run("draco_encoder", &options, &raw, &packed)?;
    run("draco_decoder", &[], &packed, &back)?;
    let size = usize::try_from(fs::metadata(&packed).ok()?.len()).ok()?;
    Some((size, vertices(&fs::read(&back).ok()?)?))
}

fn run(program: &str, options: &[&str], from: &Path, to: &Path) -> Option<()> {
    let mut command = Command::new(program);
    command.args(options).arg("-i").arg(from).arg("-o").arg(to);
    command
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null());
    command.status().ok()?.success().then_some(())
}

/// Vertices of what Draco's decoder writes: binary little endian, `float x y z` alone.
fn vertices(ply: &[u8]) -> Option<Vec<DVec3>> {
    const END: &[u8] = b"end_header\n";
    let start = ply.windows(END.len()).position(|w| w == END)? + END.len();
    let floats: Vec<f64> = ply[start..]
        .chunks_exact(4)
        .map(|b| f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]])))
        .collect();
    Some(floats.chunks_exact(3).map(DVec3::from_slice).collect())
}

/// A folder that goes when it is no longer needed.
struct Scratch(std::path::PathBuf);

impl Scratch {
    fn new() -> Option<Self> {
        use std::sync::atomic::{AtomicU32, Ordering};
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let name = format!("saint-live-{}-{number}", std::process::id());
        let path = std::env::temp_dir().join(name);
        // not create_dir_all: a folder that is there already is somebody else's
        fs::create_dir(&path).ok()?;
        Some(Self(path))
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        // what stays behind is the system's to clean
        let _ = fs::remove_dir_all(&self.0);
    }
}
