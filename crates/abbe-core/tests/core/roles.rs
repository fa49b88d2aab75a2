//! Roles of status columns.

use abbe_core::{Axis, AxisKind, Branch, StatusRole};

#[test]
fn some_roles_give_the_names_of_columns() {
    let axis = |(status, name): (usize, &str)| Axis {
        name: name.to_owned(),
        kind: AxisKind::Linear,
        branch: Branch::Tool,
        sense: 1.0,
        direction: [1.0, 0.0, 0.0],
        range: None,
        indexed: false,
        endless: false,
        status,
    };
    let axes: Vec<Axis> = ["X", "Z"].into_iter().enumerate().map(axis).collect();
    for (role, name) in [
        (StatusRole::Command(1), "Z"),
        (StatusRole::Direction(0), "dir_X"),
        (StatusRole::Time, "time"),
        (StatusRole::Stylus, "stylus"),
    ] {
        assert_eq!(role.column_name(&axes).as_deref(), Some(name));
    }
    assert_eq!(StatusRole::Temperature.column_name(&axes), None);
}
