//! Programs of a machine with three linear axes that carry the tool.

use abbe_core::{
    Absent, Axis, AxisKind, Branch, Column, ColumnHeader, Dataset, KinematicModel, ModelInfo, PoseBatch, PosesMut,
    Quantity, Result, RowOrigin, StatusColumn, StatusRole, Values,
};

use crate::{Block, Measuring, Programme, Touches};

struct Cartesian(ModelInfo);

impl Cartesian {
    fn new() -> Self {
        let names = ["X", "Y", "Z"];
        let axes = names.iter().enumerate().map(|(index, name)| Axis {
            name: (*name).to_owned(),
            kind: AxisKind::Linear,
            branch: Branch::Tool,
            sense: 1.0,
            direction: [0, 1, 2].map(|axis| f64::from(u8::from(axis == index))),
            range: Some([-100.0, 100.0]),
            indexed: false,
            endless: false,
            status: index,
        });
        let status = names.iter().enumerate().map(|(index, name)| StatusColumn {
            name: (*name).to_owned(),
            role: StatusRole::Command(index),
            quantity: Quantity::Length,
            levels: Vec::new(),
            absent: Absent::Required,
        });
        let info = ModelInfo::new(axes.collect(), status.collect(), Vec::new(), serde_json::Value::Null);
        Self(ModelInfo { stylus_radius: 2.0, ..info })
    }
}

impl KinematicModel for Cartesian {
    fn info(&self) -> &ModelInfo {
        &self.0
    }

    fn evaluate(&self, batch: PoseBatch<'_>, out: PosesMut<'_>) -> Result<()> {
        for (pose, status) in batch.statuses.chunks_exact(3).enumerate() {
            out.positions[pose] = [status[0], status[1], status[2]];
            if batch.orientation {
                out.orientations[pose] = [1.0, 0.0, 0.0, 0.0];
            }
            for (place, wanted) in batch.wanted.iter().enumerate() {
                if let abbe_core::Variable::Command(axis) = wanted {
                    out.position_derivatives[pose * batch.wanted.len() + place][*axis] = 1.0;
                }
            }
        }
        Ok(())
    }
}

/// Touches of facets from above, at these places of X and Y; the surface is at z = 0.
fn table(places: &[[f64; 2]], normal: [f64; 3]) -> Dataset {
    let labels = |name: &str, make: &dyn Fn(usize) -> String| Column {
        header: ColumnHeader::parse(name),
        values: Values::Labels((0..places.len()).map(|row| make(row).into()).collect()),
    };
    let numbers = |name: &str, make: &dyn Fn(usize) -> f64| Column {
        header: ColumnHeader::parse(name),
        values: Values::Numbers((0..places.len()).map(make).collect()),
    };
    let columns = vec![
        labels("touch", &|row| (row + 1).to_string()),
        labels("feature", &|row| format!("F{row}")),
        numbers("X_mm", &|row| places[row][0]),
        numbers("Y_mm", &|row| places[row][1]),
        numbers("Z_mm", &|_| 2.0),
        numbers("nx", &|_| normal[0]),
        numbers("ny", &|_| normal[1]),
        numbers("nz", &|_| normal[2]),
    ];
    let origins = (0..places.len()).map(|row| RowOrigin { file: 0, line: row + 2, row: row + 1 }).collect();
    Dataset { columns, origins, files: vec!["plan.csv".into()], ..Dataset::default() }
}

fn settings(more: serde_json::Value) -> Measuring {
    let mut all = serde_json::json!({
        "control": "linuxcnc",
        "probe": [{ "diameter_mm": 3, "length_mm": 30 }, { "diameter_mm": 30, "length_mm": 60 }],
        "clearance": { "plane": { "axis": "Z", "at_mm": 50 } },
    });
    more.as_object()
        .into_iter()
        .flatten()
        .for_each(|(key, value)| drop(all.as_object_mut().unwrap().insert(key.clone(), value.clone())));
    let settings: Measuring = serde_json::from_value(all).unwrap();
    settings.check().unwrap();
    settings
}

fn touches(places: &[[f64; 2]]) -> Touches {
    Touches::of_table(&table(places, [0.0, 0.0, 1.0]), &Cartesian::new()).unwrap()
}

/// The digits were computed by another program from the text of docs/measuring-log.md.
#[test]
fn the_hash_is_that_of_the_canonical_text() {
    let touches = touches(&[[1.5, -2.0], [-0.0000001, 3.25]]);
    assert_eq!(touches.hash(&Cartesian::new()), "B122C69FDA480110");
}

#[test]
fn a_plan_is_read_as_it_was_written() {
    let (model, touches) = (Cartesian::new(), touches(&[[1.5, -2.0], [10.0, 3.25]]));
    let text = touches.table(&model);
    assert_eq!(
        text.lines().nth(1),
        Some("1,F0,1.500000,-2.000000,2.000000,1.500000,-2.000000,0.000000,0.000000,0.000000,1.000000")
    );
}

#[test]
fn short_ways_keep_the_numbers_of_touches() {
    let touches = touches(&[[0.0, 0.0], [60.0, 0.0], [20.0, 0.0], [40.0, 0.0]]);
    let numbers = |more: serde_json::Value| -> Vec<usize> {
        let program = Programme::new(&settings(more), &touches, &[], &Cartesian::new(), None).unwrap();
        let number = |block: &Block| if let Block::Touch(touch) = block { Some(touch.number) } else { None };
        program.blocks.iter().filter_map(number).collect()
    };
    assert_eq!(numbers(serde_json::json!({})), [1, 3, 4, 2]);
    assert_eq!(numbers(serde_json::json!({ "order": "planned" })), [1, 2, 3, 4]);
}

/// A block in the way is named; beside it the way is free.
#[test]
fn the_shank_keeps_clear_of_solids() {
    let touches = touches(&[[0.0, 0.0]]);
    let made = |x: f64| {
        let block = serde_json::json!({ "solids": [{ "box": { "from_mm": [x, -5, 0], "to_mm": [x + 20.0, 5, 40] } }] });
        Programme::new(&settings(block), &touches, &[], &Cartesian::new(), None)
    };
    // The wide section has a radius of 15 and begins 30 above the tip: it meets the block up to x = 16.
    assert!(made(16.1).is_ok());
    let error = made(15.9).unwrap_err().to_string();
    assert!(error.contains("touch 1 (feature F0)") && error.contains("solid 1 of `solids`"), "{error}");
    assert!(made(-15.0).is_err());
}

/// The faces of a table are touched although the table is a solid, and what stands out of it is in the way.
#[test]
fn faces_lie_on_a_solid() {
    let touches = touches(&[[0.0, 0.0], [30.0, 0.0]]);
    let made = |from: [f64; 3], to: [f64; 3]| {
        let block = serde_json::json!({ "solids": [{ "box": { "from_mm": from, "to_mm": to } }] });
        Programme::new(&settings(block), &touches, &[], &Cartesian::new(), None)
    };
    assert!(made([-50.0, -50.0, -30.0], [50.0, 50.0, 0.0]).is_ok());
    // A little lower is near enough to be meant.
    assert!(made([-50.0, -50.0, -30.0], [50.0, 50.0, -0.5]).is_ok());
    for top in [0.1, -2.0] {
        let error = made([-50.0, -50.0, -30.0], [50.0, 50.0, top]).unwrap_err().to_string();
        assert!(error.contains("touch 1 (feature F0)") && error.contains("the tip would come to"), "{top}: {error}");
    }
    // Its edge is beside the second touch: that face does not lie on it, and the tip comes too near.
    let error = made([-50.0, -50.0, -30.0], [28.5, 50.0, 0.0]).unwrap_err().to_string();
    assert!(!error.contains("touch 1 ") && error.contains("touch 2 "), "{error}");
}

#[test]
fn travel_and_pauses() {
    let far = Touches::of_table(&table(&[[99.0, 0.0]], [-1.0, 0.0, 0.0]), &Cartesian::new()).unwrap();
    let error = Programme::new(&settings(serde_json::json!({})), &far, &[], &Cartesian::new(), None).unwrap_err();
    assert!(error.to_string().contains("do not reach the end of the touch"), "{error}");
    let touches = touches(&[[0.0, 0.0], [20.0, 0.0], [40.0, 0.0]]);
    let pause = settings(serde_json::json!({ "pause": { "touches": 2 } }));
    let program = Programme::new(&pause, &touches, &[], &Cartesian::new(), None).unwrap();
    assert_eq!(program.blocks.iter().filter(|block| matches!(block, Block::Pause(_))).count(), 1);
    // Two balls' width above, a dry run has no touch.
    let program = Programme::new(&pause, &touches, &[], &Cartesian::new(), Some(8.0)).unwrap();
    assert!(!program.blocks.iter().any(|block| matches!(block, Block::Touch(_))));
}

/// The sum of the moves by hand: 43 mm down and up, 60 mm to the second touch, and the touches.
#[test]
fn a_program_takes_what_its_moves_take() {
    let (model, touches) = (Cartesian::new(), touches(&[[0.0, 0.0], [60.0, 0.0]]));
    let seconds =
        |more: serde_json::Value| Programme::new(&settings(more), &touches, &[], &model, None).unwrap().seconds;
    let ways = (4.0 * 43.0 + 60.0) / 1000.0;
    let slow = 5.0 / 30.0 + 5.0 / 1000.0;
    assert!((seconds(serde_json::json!({})) - 60.0 * (ways + 2.0 * slow)).abs() < 1e-9);
    let twice = 5.0 / 200.0 + 0.5 / 1000.0 + 0.5 / 30.0 + 5.0 / 1000.0;
    let more = serde_json::json!({ "search_feed_mm_per_min": 200, "repeats": 3 });
    assert!((seconds(more) - 60.0 * (ways + 6.0 * twice)).abs() < 1e-9);
    // What is timed before a plan is chosen is what its program says.
    let settings = settings(serde_json::json!({ "search_feed_mm_per_min": 200 }));
    let timing = crate::Timing::new(&settings, &touches, &[], &model).unwrap();
    assert!((timing.seconds(&[1, 0], false, 3).unwrap() - 60.0 * (ways + 6.0 * twice)).abs() < 1e-9);
    assert!(timing.seconds(&[0], false, 1).unwrap() < timing.seconds(&[0, 1], false, 1).unwrap());
    assert_eq!(timing.refusal(0).unwrap(), None);
}
