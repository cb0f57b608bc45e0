//! `mutate TARGET SECONDS [SEED]`: a plain loop over mutated seeds, for where libFuzzer cannot be
//! built. The input at hand lies in `corpus/TARGET.last`; after a crash it is the finding.

use std::path::Path;
use std::time::{Duration, Instant};

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    let usage = "mutate TARGET SECONDS [SEED]";
    let name = arguments.get(1).expect(usage);
    let seconds: f64 = arguments.get(2).expect(usage).parse().expect(usage);
    let mut state: u64 = arguments
        .get(3)
        .map_or(1, |seed| seed.parse().expect(usage));
    let target = saint_live_fuzz::TARGETS
        .iter()
        .find(|t| t.0 == name)
        .expect("no such target")
        .1;
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus");
    let mut paths: Vec<_> = std::fs::read_dir(corpus.join(name))
        .expect("run `seeds` first")
        .map(|entry| entry.unwrap().path())
        .collect();
    paths.sort();
    let seeds: Vec<_> = paths
        .iter()
        .map(|path| std::fs::read(path).unwrap())
        .collect();
    let mut below = |n: usize| {
        state = state.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = state;
        z = (z ^ z >> 30).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ z >> 27).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ z >> 31) % n.max(1) as u64) as usize
    };
    let (start, mut runs, mut slowest) = (Instant::now(), 0u64, Duration::ZERO);
    while start.elapsed().as_secs_f64() < seconds {
        let mut input = seeds[below(seeds.len())].clone();
        for _ in 0..=below(6) {
            let at = below(input.len());
            let end = (at + 1 + below(8)).min(input.len());
            match below(7) {
                0 => input[at] ^= 1 << below(8),
                1 => input[at] = below(256) as u8,
                2 => input[at..end].fill([0, 255][below(2)]),
                3 => input.truncate(at),
                4 => drop(input.drain(at..end)),
                5 => {
                    let piece: Vec<u8> = (0..below(8)).map(|_| below(256) as u8).collect();
                    input.splice(at..at, piece);
                }
                _ => {
                    let other = &seeds[below(seeds.len())];
                    let from = below(other.len());
                    let to = (from + below(64)).min(other.len());
                    input.splice(at..end, other[from..to].iter().copied());
                }
            }
            if input.is_empty() {
                break;
            }
        }
        std::fs::write(corpus.join(format!("{name}.last")), &input).unwrap();
        let before = Instant::now();
        target(&input);
        let took = before.elapsed();
        if took > slowest.max(Duration::from_millis(500)) {
            println!("{name}: {took:?} for {} bytes", input.len());
            std::fs::write(corpus.join(format!("{name}.slow")), &input).unwrap();
        }
        slowest = slowest.max(took);
        runs += 1;
    }
    println!("{name}: {runs} runs, slowest {slowest:?}");
}
