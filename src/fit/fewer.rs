//! One sphere fewer: the sphere with the fewest points of its own is taken out, and the spheres
//! near those points are bent so that they cover them too.
//!
//! Deviation. Paper 3.2 keeps every sphere it found. Found one after the other, each takes what it
//! can and leaves slivers to the next; bent together, the others can take some slivers in.

use super::bend::Bends;
use super::cover::Cover;
use super::draw::Draw;
use super::ordered::Ordered;

/// Spheres given up in vain before the cover stays as it is.
const VAIN: usize = 1;
/// Spheres tried for the points of one.
const HELPERS: usize = 12;
/// Rounds over them.
const ROUNDS: usize = 2;
/// Bends of each.
const BENDS: usize = 200;
/// How near a helper passes by the points, contact distances.
const NEAR: f64 = 4.0;

/// Takes spheres out of a cover while no more than `allowed` points stay uncovered.
pub(crate) fn fewer(cover: &mut Cover, points: &Ordered, allowed: usize, draw: &mut Draw) {
    let mut spared: Vec<usize> = Vec::new();
    let mut domain = Vec::new();
    let mut bends = Bends::default();
    let mut open = Vec::new();
    while spared.len() < VAIN && cover.spheres.len() > 1 {
        let own = cover.own_counts();
        let candidates = (0..own.len()).filter(|s| !spared.contains(s));
        let Some(given_up) = candidates.min_by_key(|&s| own[s]) else {
            break;
        };
        let mut undo = vec![cover.take(given_up, &mut open)];
        let begun = open.len();
        'search: for round in 0..ROUNDS {
            // half the way in the first round, or there is no hope
            if round > 0 && 2 * open.len() > begun + allowed {
                break;
            }
            for s in helpers(cover, points, &open, given_up) {
                if open.len() <= allowed {
                    break 'search;
                }
                cover.own(s, &mut domain);
                domain.extend_from_slice(&open);
                bends.refill(&points.lanes, &domain);
                if let Some(bent) = bends.best(&cover.spheres[s], BENDS, draw) {
                    undo.push(cover.replace(s, bent, points, &mut open));
                }
            }
        }
        if open.len() <= allowed {
            cover.forget(given_up);
            cover.prune(allowed);
            spared.clear();
        } else {
            cover.undo(undo);
            spared.push(given_up);
        }
    }
}

/// The spheres that pass by the most of the `open` points, most first.
fn helpers(cover: &Cover, points: &Ordered, open: &[u32], except: usize) -> Vec<usize> {
    let passes = |s: usize| {
        let near = |&&i: &&u32| {
            let i = i as usize;
            let reach = NEAR * f64::from(points.lanes.tau(i));
            cover.spheres[s].value(points.at(i)).abs() < reach
        };
        open.iter().filter(near).count()
    };
    let others = (0..cover.spheres.len()).filter(|&s| s != except);
    let mut near: Vec<(usize, usize)> = others.map(|s| (passes(s), s)).collect();
    near.retain(|&(count, _)| count > 0);
    near.sort_by_key(|&(count, s)| (std::cmp::Reverse(count), s));
    near.truncate(HELPERS);
    near.into_iter().map(|(_, s)| s).collect()
}
