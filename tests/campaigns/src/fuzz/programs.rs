//! NC programs in every dialect, corrected for a machine with errors; and tables of tools.

use std::path::Path;
use std::sync::Arc;

use abbe_compensation::Settings;
use abbe_controllers::{Dialect, Machine, Options, Tools, compensate};
use abbe_core::{Build, Context, Kind, KinematicModel, Registry};
use serde_json::json;

use super::Target;
use super::seeds::{folder, texts};
use super::texts::text;

const PLAIN: [&str; 5] = [
    "G21 G17 G90 G54\nG0 X0. Y0. Z60.\nG1 Z55. F500.\nG2 X10. Y0. I5. J0.\nG91\nG1 X1.5 Y-2.\nG90\nG3 X0. Y0. Z50. R8.\nM30\n",
    "; mill\nG71 G17 G90 G54\nG0 X0. Y0. Z60.\nG1 Z55. F500.\nG2 X10. Y0. I5. J0.\nG1 X=5.5 Y2\nM30\n",
    "G21 G90 G17\nG0 X10 Y10 Z50\nG1 X20 Y-5 Z10 F500\nG2 X30 Y5 I10 J0\nG3 X20 Y-5 R14 Z12\nG91\nG1 X1\nM30\n",
    "N10 G54\nN20 T1 M6\nN30 G43 H1\nN40 G1 X1.5Y2Z3 F100\nN50 G93 G1 X2 F10\nN60 G18 G2 X5 Z5 R4\nN70 G92.1\nM2\n",
    "0 BEGIN PGM T MM\n1 L X+10 Y+10 Z+50 R0 FMAX\n2 L X+20 Y+0 F500\n3 CC X+0 Y+0\n4 C X+0 Y+20 DR+\n5 L IX-1.5\n6 END PGM T MM\n",
];

pub fn targets() -> Vec<Target> {
    let mut seeds = folder("tests/programs/public", &["nc", "ngc", "h", "mpf"]);
    seeds.extend(texts(PLAIN));
    let of_dialect = |dialect: Dialect| {
        let (model, values) = machine();
        Target::new(&format!("program-{}", dialect.name()), seeds.clone(), move |input| {
            let build = |length: Option<f64>| {
                Machine::new(model.clone(), values.clone(), Settings::default(), length.unwrap_or(100.0), None)
            };
            let mut options = Options::new(dialect);
            options.tolerance = 0.01;
            compensate(&mut &*input, &mut std::io::sink(), &build, &options)
                .map(drop)
                .map_err(|error| error.to_string())
        })
    };
    let mut targets: Vec<Target> = Dialect::ALL.into_iter().map(of_dialect).collect();
    let tables = texts(["tool,length_mm\n1,100\n2,57.25\n", "1 = 100\n", "T1 P1 D6 Z100.5 ; mill\n", "{\"1\": 100}"]);
    targets.push(Target::new("tools", tables, |input| {
        Tools::read(&text(input), Path::new("tools.csv")).map(drop).map_err(|error| error.to_string())
    }));
    targets
}

/// A machine of three axes, whose every error is a little off.
pub fn machine() -> (Arc<dyn KinematicModel>, Vec<f64>) {
    let settings = json!({
        "chain": "w b X Y Z t",
        "tool_length_mm": 100,
        "stylus_radius_mm": 0,
        "axes": { "X": { "range_mm": [-500, 500] }, "Y": { "range_mm": [-500, 500] }, "Z": { "range_mm": [-500, 500] } },
        "errors": [{ "location": ["EC0Y", "EA0Z", "EB0Z"] }, { "polynomial": ["EXX", "EYX", "EZZ"], "degrees": [1, 2] }],
    });
    let registry = Registry::built_in().expect("plugins");
    let plugin = registry.find(Kind::Model, "serial-chain").expect("a model");
    let Build::Model(constructor) = &plugin.build else { unreachable!() };
    let stage = constructor.build(&settings, &Context { base: std::env::temp_dir() }).expect("a model");
    let model = stage.build(&[]).expect("a machine");
    let small = |per: bool| if per { 1e-6 } else { 1e-4 };
    let values = model.info().parameters.iter().map(|parameter| small(parameter.unit.per.is_some())).collect();
    (model, values)
}
