//! Calibrations from starts so far off that the first step leads to where struts hold no platform.

use std::path::PathBuf;
use std::sync::atomic::{AtomicUsize, Ordering};

use abbe_gauss_newton as _;
use nalgebra::{UnitQuaternion, Vector3};
use serde_json::json;

use super::*;

/// Poses that are measured.
const POSES: usize = 40;

/// Calibrations that are started.
const STARTS: u64 = 1200;

/// Numbers that look random and are the same in every run (Knuth's linear congruential generator).
struct Random(u64);

impl Random {
    fn number(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }

    fn vector(&mut self, size: f64) -> Vector3<f64> {
        Vector3::from([(); 3].map(|()| size * self.number()))
    }
}

/// Positions of the tip, each measured at six strut lengths.
struct Centres {
    info: ObservationsInfo,
    measured: Vec<[f64; 3]>,
}

impl Observations for Centres {
    fn info(&self) -> &ObservationsInfo {
        &self.info
    }

    fn evaluate(&self, batch: RowBatch<'_>, out: &mut Equations) -> Result<()> {
        for (&RowIndex(row), position) in batch.rows.iter().zip(batch.positions) {
            for component in 0..3 {
                out.equation(position[component] - self.measured[row][component]);
                let mut derivative = [0.0; 3];
                derivative[component] = 1.0;
                out.position(derivative);
            }
        }
        Ok(())
    }
}

/// A hexapod that counts how often it is asked, and how often it refuses.
struct Counting {
    hexapod: Hexapod,
    refused: AtomicUsize,
}

impl KinematicModel for Counting {
    fn info(&self) -> &ModelInfo {
        self.hexapod.info()
    }

    fn evaluate(&self, batch: PoseBatch<'_>, out: PosesMut<'_>) -> Result<()> {
        let done = self.hexapod.evaluate(batch, out);
        self.refused.fetch_add(usize::from(done.is_err()), Ordering::Relaxed);
        done
    }
}

/// Strut lengths at which a hexapod with no errors has some poses, and where its tip is there.
fn measured(settings: &Settings) -> (Vec<[f64; 6]>, Vec<[f64; 3]>) {
    let random = &mut Random(7);
    let poses = (0..POSES).map(|_| {
        let at = Vector3::from(settings.home_mm) + random.vector(80.0);
        let turn = UnitQuaternion::from_scaled_axis(random.vector(0.25));
        let joints = settings.platform_joints_mm.iter().zip(&settings.base_joints_mm);
        let lengths = joints.map(|(joint, base)| (at + turn * Vector3::from(*joint) - Vector3::from(*base)).norm());
        let lengths: Vec<f64> = lengths.collect();
        let lengths: [f64; 6] = lengths.try_into().expect("six struts");
        let tip: [f64; 3] = (at + turn * Vector3::from(settings.tip_mm)).into();
        (lengths, tip)
    });
    poses.unzip()
}

fn estimator() -> Box<dyn Estimate> {
    let registry = Registry::built_in().expect("plugins");
    let Build::Estimate(constructor) = &registry.find(Kind::Estimate, "gauss-newton").expect("it is linked").build
    else {
        panic!("an estimator was asked for")
    };
    constructor.build(&json!({}), &Context { base: PathBuf::new() }).expect("settings")
}

#[test]
fn a_step_to_where_struts_hold_no_platform_is_halved() {
    let settings: Settings = serde_json::from_value(settings::example()).expect("the example");
    let (lengths, measured) = measured(&settings);
    let model =
        Arc::new(Counting { hexapod: Hexapod::new(settings).expect("a hexapod"), refused: AtomicUsize::new(0) });
    let column = |strut: usize| Column {
        header: ColumnHeader::parse(&format!("L{}_mm", strut + 1)),
        values: Values::Numbers(lengths.iter().map(|lengths| lengths[strut]).collect()),
    };
    let data = Arc::new(Dataset {
        columns: (0..6).map(column).collect(),
        origins: (0..POSES).map(|row| RowOrigin { file: 0, line: row + 2, row: row + 1 }).collect(),
        files: vec![PathBuf::from("centres.csv")],
        averaged: false,
        is_log: false,
        stated_tips: Vec::new(),
    });
    let mut layout = Layout::new(&data, model.as_ref(), &[&plain_naming]).expect("a layout");
    data.row_indices().for_each(|row| layout.push(model.as_ref(), row, &[1e-3; 3]).expect("a row"));
    let info = ObservationsInfo::new(layout, Vec::new(), Contact::Reading("centre".to_owned()));
    let sets = vec![ObservationSet::new("centres", Arc::new(Centres { info, measured }))];
    let patterns = ["strut[?].length", "strut[?].base.?", "d?t"].map(str::to_owned);
    let problem = Problem::new("fit", "vendor-hexapod", model.clone(), sets, &patterns).expect("a problem");

    let estimator = estimator();
    let (mut plain, mut saved, mut lost) = (0, 0, Vec::new());
    for seed in 0..STARTS {
        let random = &mut Random(seed);
        // The first numbers of neighbouring seeds are alike.
        (0..9).for_each(|_| _ = random.number());
        let size = 50.0 + 300.0 * random.number().abs();
        let start: Vec<f64> = problem.unknowns.iter().map(|_| size * random.number()).collect();
        if problem.residuals(&start).is_err() {
            continue;
        }
        let before = model.refused.load(Ordering::Relaxed);
        let found = estimator.estimate(&problem.with_values(&start));
        // The first step is tried by a gradient and the triangle of the nominal hexapod, which lead far out from here: one refusal.
        // Each further one is that of a step that is halved.
        let halved = model.refused.load(Ordering::Relaxed) > before + 1;
        match found {
            Ok(found) => {
                let off = problem.values_of(&found).iter().fold(0.0_f64, |off, value| off.max(value.abs()));
                assert!(off < 1e-9, "start {seed} of {size} mm: off by {off} mm");
                *(if halved { &mut saved } else { &mut plain }) += 1;
            }
            Err(error) => lost.push((halved, error)),
        }
    }
    println!("{plain} converged without halving, {saved} with it, these did not: {lost:#?}");
    assert!(saved > 100 && plain > 100, "{saved} {plain}");
    // At the border itself no direction may lead on; then no step is better, steps are cut again and again or to next to nothing, or the
    // refusal is told with its row.
    assert!(lost.len() <= 4, "{lost:#?}");
    let ends = ["no step", "cut again and again", "no longer shrink"];
    assert!(lost.iter().all(|(halved, error)| {
        *halved && (error.place.is_some() || ends.iter().any(|end| error.message.contains(end)))
    }));
}
