//! Typed indices, as texts and into lists.

use serde_json::json;

use abbe_core::{DataRow, LayoutEquation, NominalReading, Owner, PoseIndex, RankPoint, Row, RowIndex, SetIndex};

const ROW: Row = Row {
    first_pose: PoseIndex(1),
    poses: 0,
    first_equation: LayoutEquation(1),
    equations: 2,
    data_row: Some(DataRow(5)),
};

#[test]
fn indices_are_plain_numbers_in_texts() {
    let text = json!({ "first_pose": 1, "poses": 0, "first_equation": 1, "equations": 2, "data_row": 5 });
    assert_eq!(serde_json::to_value(ROW).unwrap(), text);
    assert_eq!(serde_json::from_value::<Row>(text).unwrap(), ROW);
    assert_eq!(serde_json::to_value(Owner::Set(SetIndex(6))).unwrap(), json!({ "set": 6 }));
    let nominal = NominalReading { residuals: vec![0.5], axes: vec![0] };
    let rank_point = RankPoint::NominalReading([(RowIndex(7), nominal)].into());
    let text = json!({ "nominal-reading": { "7": { "residuals": [0.5], "axes": [0] } } });
    assert_eq!(serde_json::to_value(&rank_point).unwrap(), text);
    assert_eq!(serde_json::from_value::<RankPoint>(text).unwrap(), rank_point);
}

#[test]
fn lists_take_indices_and_ranges_of_them() {
    let mut uncertainties = vec![1.0, 2.0, 3.0, 4.0];
    uncertainties[ROW.equation_indices()].fill(0.0);
    uncertainties[ROW.first_equation + 2] = 5.0;
    assert_eq!(uncertainties, [1.0, 0.0, 0.0, 5.0]);
    let equations = ROW.equation_indices();
    assert_eq!((equations.start(), equations.end(), equations.len()), (LayoutEquation(1), LayoutEquation(3), 2));
    assert!(equations.contains(LayoutEquation(2)) && !equations.contains(LayoutEquation(3)));
    assert_eq!(equations.collect::<Vec<_>>(), [1, 2].map(LayoutEquation));
    assert_eq!(ROW.pose_indices().next(), None);
}
