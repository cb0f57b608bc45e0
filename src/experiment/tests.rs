use super::*;
use crate::contact_map::polar::PolarGrid;
use crate::fit::cloud::CloudSphere;
use crate::fit::contact_distance::ContactDistance;
use glam::DVec3;

fn ball_points(count: usize, center: DVec3, radius: f64, seed: u64) -> Vec<DVec3> {
    let mut chance = Chance::new(seed);
    let point = |_| {
        let v = DVec3::new(chance.normal(), chance.normal(), chance.normal());
        center + radius * v.normalize()
    };
    (0..count).map(point).collect()
}

fn balls(count: usize) -> Subject {
    let mut points = ball_points(count / 2, DVec3::ZERO, 1.0, 1);
    points.extend(ball_points(count / 2, DVec3::X * 3.0, 0.5, 2));
    Subject::cloud("two balls", &points, None, usize::MAX).unwrap()
}

const ONCE: Effort = Effort { seeds: 1 };

#[test]
fn chance_is_fair_and_repeatable() {
    let draw = |seed| {
        let mut chance = Chance::new(seed);
        (0..20_000)
            .map(move |_| chance.normal())
            .collect::<Vec<f64>>()
    };
    assert_eq!(draw(3), draw(3));
    assert_ne!(draw(3), draw(4));
    let values = draw(3);
    let mean = values.iter().sum::<f64>() / 2e4;
    let square = values.iter().map(|v| v * v).sum::<f64>() / 2e4;
    assert!(
        mean.abs() < 0.03 && (square - 1.0).abs() < 0.04,
        "{mean} {square}"
    );
}

#[test]
fn cells_read_as_numbers() {
    assert_eq!(Cell::spread(&[1.0, 2.0, 3.0]), Cell::Spread(2.0, 1.0));
    assert_eq!(Cell::Spread(12.345, 0.123).to_string(), "12.35 ±0.12");
    assert_eq!(Cell::Spread(7.0, 0.0).to_string(), "7");
    assert_eq!(Cell::Number(0.012_345).to_string(), "0.01235");
    assert_eq!(Cell::Number(1e-12).to_string(), "1.000e-12");
    assert_eq!(Cell::spread(&[]).to_string(), "–");
    assert_eq!(
        serde_json::to_string(&Cell::Spread(2.0, 1.0)).unwrap(),
        r#"{"mean":2.0,"deviation":1.0}"#
    );
}

#[test]
fn bad_clouds_are_refused_and_large_ones_thinned() {
    let few = Subject::cloud("few", &[DVec3::ONE; 10], None, 100);
    let one_place = Subject::cloud("one place", &[DVec3::ONE; 100], None, 100);
    for refused in [few, one_place] {
        let text = refused.unwrap_err().to_string();
        assert!(text.contains("at least 50"), "{text}");
    }
    let mut points = ball_points(1000, DVec3::ZERO, 1.0, 1);
    points[5] = DVec3::NAN;
    let subject = Subject::cloud("ball", &points, None, 300).unwrap();
    assert_eq!(subject.points.len(), 250);
    let share = subject.contact.floor_m / subject.diagonal_m();
    assert!((share * 500.0 - 1.0).abs() < 0.05, "{share}");
    let said = subject.describe();
    // two digits, as they are read back
    assert!(said.ends_with("mm"), "{said}");
}

#[test]
fn two_balls_need_two_spheres() {
    let report = multi_scale::run(&[balls(2000)], ONCE).unwrap();
    for table in &report.tables {
        for row in &table.rows {
            let explained = row[3].value().unwrap();
            assert!(explained > 99.8, "{}: {explained}", table.title);
        }
    }
    // the error left is that of the map's cells: half the contact distance each
    let (contact, chamfer) = (&report.tables[0].rows[0][2], &report.tables[0].rows[0][4]);
    assert!(chamfer.value().unwrap() < 0.5 * contact.value().unwrap());
}

#[test]
fn a_finer_map_errs_less_and_loses_fewer_points() {
    let report = map_resolution::run(&[balls(2000)], ONCE).unwrap();
    let mean = &report.tables[0];
    let at = |mr: &str, column: &str| mean.value(&["mean", mr], column).unwrap();
    for column in [
        "merged (paper) Chamfer %",
        "every claim Chamfer %",
        "metric Chamfer %",
    ] {
        assert!(at("1024", column) < 0.2 * at("16", column), "{column}");
    }
    assert!(at("16", "points kept %") < 80.0 && at("1024", "points kept %") > 99.0);
    // every claim kept can only be nearer
    assert!(at("16", "every claim Chamfer %") <= at("16", "merged (paper) Chamfer %"));
}

#[test]
fn two_spheres_in_one_place_keep_both_claims() {
    // the same directions seen from the same centre: every cell is claimed twice
    let mut points = ball_points(500, DVec3::ZERO, 1.0, 1);
    points.extend(points.clone().iter().map(|p| *p * 2.0));
    let local = LocalPoints::new(&points).unwrap();
    let model = CloudModel {
        origin: local.origin,
        spheres: [1.0, 2.0]
            .iter()
            .filter_map(|r| CloudSphere::from_center_radius(DVec3::ZERO, *r))
            .collect(),
        assignment: (0..1000).map(|i| u32::from(i >= 500)).collect(),
        explained: 1.0,
    };
    let grid = PolarGrid::new(4096);
    let rebuilt = map_resolution::every_claim(&local, &model, grid);
    let small = rebuilt.iter().filter(|p| p.length() < 1.5).count();
    assert_eq!((small, rebuilt.len() - small), (500, 500));
    let literal = crate::contact_map::merged::LiteralMap::new(&local, &model, grid);
    assert_eq!((literal.cells.len(), literal.lost_points), (500, 500));
}

#[test]
fn a_plane_is_bent_no_more_than_allowed() {
    let mut chance = Chance::new(1);
    let mut flat = || DVec3::new(chance.unit(), chance.unit(), 0.3);
    let points: Vec<DVec3> = (0..500).map(|_| flat()).collect();
    let local = LocalPoints::new(&points).unwrap();
    let plane = CloudSphere {
        curvature: 0.0,
        normal: DVec3::Z,
        offset: local.origin.z - 0.3,
    };
    let mut model = CloudModel {
        origin: local.origin,
        spheres: vec![plane],
        assignment: vec![0; 500],
        explained: 1.0,
    };
    map_resolution::bend_planes(&local, &mut model, 0.01);
    let radius = model.spheres[0].center_radius().1;
    // half a diagonal squared, over twice a quarter of 1 cm
    assert!((80.0..110.0).contains(&radius), "{radius}");
    let distances = (0..500).map(|i| model.spheres[0].distance(local.at(i).as_dvec3()));
    let worst = distances.fold(0.0, f64::max);
    assert!((0.002..0.0026).contains(&worst), "{worst}");
    let bent = model.clone();
    map_resolution::bend_planes(&local, &mut model, 0.01);
    assert!((model.spheres[0].curvature - bent.spheres[0].curvature).abs() < 1e-9);
}

#[test]
fn packing_of_a_ball_leaves_nothing_and_counts_cells() {
    let report = packing::run(&[balls(4000)], ONCE).unwrap();
    assert_eq!(report.seeds, packing::OFFSETS);
    for row in &report.tables[0].rows {
        let [rms, cells] = [2, 8].map(|c| row[c].value().unwrap());
        // cells that hold parts of both balls are none: they are 1.5 m apart
        assert!(rms < 1e-3, "{rms} mm");
        assert!((0.97..1.03).contains(&cells), "{cells}");
    }
    // at equal spacing a hexagonal packing has up to 2^(1/2) times the cells of a volume
    let more = report.tables[2].rows[0][8].value().unwrap();
    assert!((1.05..1.42).contains(&more), "{more}");
}

#[test]
fn schemes_say_what_each_does() {
    let report = schemes::run(&[balls(2000)], Effort { seeds: 2 }).unwrap();
    let table = &report.tables[0];
    for scheme in ["random", "progressive"] {
        let at = |column| table.value(&["two balls", scheme], column).unwrap();
        assert!(at("explained %") > 99.8 && at("spheres") >= 2.0);
        assert!(at("pattern %").abs() < 20.0);
    }
}

#[test]
fn storage_states_error_and_verdict() {
    let tools = storage::Tools {
        zstd: &|bytes| Some(bytes.len() / 2),
        draco: &|_, _| None,
    };
    let report = storage::run(&[balls(2000)], ONCE, 0.2, tools).unwrap();
    let table = &report.tables[0];
    let at = |method, column| table.value(&["two balls", method], column);
    assert_eq!(at("raw", "bytes"), Some(24_000.0));
    assert_eq!(at("zstd of raw", "bytes"), Some(12_000.0));
    assert_eq!(at("Draco", "bytes"), None);
    let aimed = at("gzip of rounded", "Chamfer %").unwrap();
    assert!((aimed - 0.2).abs() < 0.02, "{aimed}");
    let reached = at("SAINT", "Chamfer %").unwrap();
    assert!(reached <= 0.21, "{reached}");
    assert!(at("SAINT", "bytes").unwrap() < at("gzip of raw", "bytes").unwrap());
    assert!(
        report.findings[0].contains("one third is"),
        "{}",
        report.findings[0]
    );
}

#[test]
fn draco_is_taken_at_the_error_aimed_at() {
    // a coder whose error halves and whose bytes grow by 1000 with each bit
    let subject = balls(2000);
    let tools = storage::Tools {
        zstd: &|_| None,
        draco: &|points, bits| {
            let off = DVec3::X * 0.5f64.powi(bits as i32);
            let moved = points.iter().map(|p| *p + off).collect();
            Some((1000 * bits as usize, moved))
        },
    };
    let report = storage::run(&[subject], ONCE, 0.2, tools).unwrap();
    let row = report.tables[0]
        .rows
        .iter()
        .find(|r| r[1].to_string().starts_with("Draco"))
        .unwrap();
    // 0.2 % of the diagonal lies between 2^-7 and 2^-6
    assert_eq!(row[1].to_string(), "Draco (between qp 6 and 7)");
    let bytes = row[2].value().unwrap();
    assert!((6000.0..7000.0).contains(&bytes), "{bytes}");
}

#[test]
fn the_loss_experiment_judges_every_goal() {
    let frames = subject::synthetic_frames(4, (96, 72)).unwrap();
    let report = loss::run(std::slice::from_ref(&frames), Effort { seeds: 2 }).unwrap();
    assert_eq!(report.tables[0].rows.len(), 5);
    for series in &report.curve.series {
        assert!(series.points.len() > 10 && series.points.iter().all(|p| p.1 > 0.0));
    }
    let truth = report.tables[0].rows[0][5].value();
    assert!(truth.is_some_and(|t| t > 0.0));
    let one = DepthFrames {
        frames: frames.frames[..1].to_vec(),
        ..frames
    };
    let text = loss::run(&[one], ONCE).unwrap_err().to_string();
    assert!(text.contains("at least two"), "{text}");
}

#[test]
fn local_spheres_tell_a_ball_from_a_plane() {
    let mut chance = Chance::new(1);
    let mut flat = || DVec3::new(chance.unit(), chance.unit(), 0.0);
    let plane: Vec<DVec3> = (0..4000).map(|_| flat()).collect();
    let ball = ball_points(4000, DVec3::ZERO, 0.2, 3);
    let subjects: Vec<Subject> = [("plane", plane), ("ball", ball)]
        .iter()
        .map(|(name, points)| Subject {
            contact: ContactDistance::constant(0.01),
            ..Subject::cloud(name, points, None, usize::MAX).unwrap()
        })
        .collect();
    let report = features::run(&subjects, ONCE).unwrap();
    let turned = |set| report.tables[0].value(&[set], "turned at random").unwrap();
    assert!(turned("local sphere alone") > 95.0);
    assert!(features::run(&subjects[..1], ONCE).is_err());
}
