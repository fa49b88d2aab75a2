//! Proves that the scale of a drift comes from the data, stays in the settings, and that drifts of the same column may
//! have different series.

use abbe_core::{Column, ColumnHeader, Dataset, KinematicModel, RowOrigin, Values, Variable};
use serde_json::json;

use crate::subject;

fn data(rows: &[(&str, f64)]) -> Dataset {
    let column = |header: &str, values| Column { header: ColumnHeader::parse(header), values };
    Dataset {
        columns: vec![
            column("day", Values::Labels(rows.iter().map(|row| row.0.into()).collect())),
            column("time_s", Values::Numbers(rows.iter().map(|row| row.1).collect())),
        ],
        origins: (0..rows.len()).map(|row| RowOrigin { file: 0, line: row + 2, row: row + 1 }).collect(),
        files: vec!["data.csv".into()],
        averaged: false,
        is_log: false,
        stated_tips: Vec::new(),
    }
}

/// d(z)/d(parameter) with all axes at zero on a day, at a time.
fn effect(model: &dyn KinematicModel, parameter: &str, day: &str, time: f64) -> f64 {
    let index = model.info().parameters.iter().position(|known| known.name == parameter).expect("the parameter");
    let row: Vec<f64> = (model.info().status.iter())
        .map(|status| match status.name.as_str() {
            "day" => status.levels.iter().position(|level| level == day).map_or(f64::NAN, |level| level as f64),
            "time" => time,
            _ => 0.0,
        })
        .collect();
    let values = &model.info().nominal;
    subject::poses(model, &row, values, &[Variable::Parameter(index)]).position_derivatives[0][2]
}

#[test]
fn the_scale_comes_from_the_data_and_stays() {
    let settings = json!({
        "chain": "w X b Z t", "tool_length_mm": 100.0, "stylus_radius_mm": 0.0,
        "errors": [
            { "drift": ["dzt"], "degrees": [1, 2] }, { "drift": ["dzt"], "degrees": [1, 2], "per": "day" },
        ],
    });
    let first = data(&[("mon", 30.0), ("mon", 10.0), ("tue", 100.0)]);
    let second = data(&[("tue", 140.0), ("mon", 20.0)]);
    let fitted = subject::model(&settings, &[&first, &second]);
    // Built again from what it says of itself, without data.
    let again = subject::model(&fitted.info().settings, &[]);
    for model in [&fitted, &again] {
        let names: Vec<&str> =
            model.info().parameters.iter().skip(12).map(|parameter| parameter.name.as_str()).collect();
        let expected = ["dzt[t1]", "dzt[t2]", "dzt[daymon.t1]", "dzt[daymon.t2]", "dzt[daytue.t1]", "dzt[daytue.t2]"];
        assert_eq!(names, expected);
        let cases = [
            ("dzt[t1]", "mon", 10.0, -1.0),
            ("dzt[t1]", "tue", 140.0, 1.0),
            ("dzt[t2]", "tue", 75.0, -0.5),
            ("dzt[daymon.t1]", "mon", 10.0, -1.0),
            ("dzt[daymon.t1]", "mon", 30.0, 1.0),
            ("dzt[daymon.t1]", "tue", 30.0, 0.0),
            ("dzt[daytue.t2]", "tue", 120.0, -0.5),
            ("dzt[daytue.t2]", "wed", 120.0, 0.0),
            ("dzt[t1]", "mon", f64::NAN, 0.0),
            ("dzt[daymon.t1]", "mon", f64::NAN, 0.0),
        ];
        for (parameter, day, time, expected) in cases {
            assert!((effect(&**model, parameter, day, time) - expected).abs() < 1e-15, "{parameter} {day} {time}");
        }
    }
}

#[test]
fn drifts_of_one_column_may_have_different_series() {
    let settings = json!({
        "chain": "w X b Z t", "tool_length_mm": 100.0, "stylus_radius_mm": 0.0,
        "errors": [
            { "drift": ["dxt"], "degrees": [1], "per": "day", "time_s": { "1": [0.0, 10.0], "2": [10.0, 20.0] } },
            { "drift": ["dzt"], "degrees": [1], "per": "day", "time_s": { "2": [10.0, 20.0], "3": [20.0, 30.0] } },
        ],
    });
    let model = subject::model(&settings, &[]);
    for (parameter, day, time, expected) in [
        ("dzt[day2.t1]", "2", 20.0, 1.0),
        ("dzt[day2.t1]", "1", 10.0, 0.0),
        ("dzt[day3.t1]", "3", 20.0, -1.0),
        ("dzt[day3.t1]", "2", 20.0, 0.0),
    ] {
        assert_eq!(effect(&*model, parameter, day, time), expected, "{parameter} on day {day}");
    }
}
