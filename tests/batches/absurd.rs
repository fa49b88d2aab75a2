//! Rows in batches that no machine can have made: what tells them of rows that are held tells them here, too, by rows that are chosen at
//! random.

use super::*;

/// The recipe with its touches over and over, one column of them negated, as a file of their own.
fn negated(recipe: Variant, at: &Path, (column, copies): (&str, usize)) -> Variant {
    let touches = read(&recipe.path("touches", "path"));
    let head = touches.lines().position(|line| line.contains("X_mm")).expect("a header");
    let header: Vec<&str> = touches.lines().nth(head).expect("a header").split(',').collect();
    let place = header.iter().position(|name| *name == column);
    let random = &mut Random::new(31);
    let mut text: Vec<String> = touches.lines().take(head + 1).map(str::to_owned).collect();
    for _ in 0..copies {
        for line in touches.lines().skip(head + 1).filter(|line| !line.is_empty() && !line.starts_with('#')) {
            let cells = line.split(',').enumerate().map(|(own, cell)| {
                let moved = ["X_mm", "Y_mm", "Z_mm"].contains(&header[own]);
                let sign = if Some(own) == place { -1.0 } else { 1.0 };
                match cell.parse::<f64>() {
                    Ok(number) if moved => format!("{:.6}", sign * (number + 5e-4 * random.normal())),
                    Ok(number) if sign < 0.0 => format!("{}", -number),
                    _ => cell.to_owned(),
                }
            });
            text.push(cells.collect::<Vec<_>>().join(","));
        }
    }
    write(&at.join("touches.csv"), &(text.join("\n") + "\n"));
    recipe.set("touches", "path", json!("touches.csv"))
}

#[test]
fn absurd_rows_in_batches_do_not_pass() {
    // More copies than there are chosen rows, and fewer.
    for (column, copies, status, said) in [
        ("Y_mm", 1, 1, "no machine has such errors: EYY[1] = -486 mm over the recorded travel"),
        ("Y_mm", 20, 1, "with Y negated all errors are plausible"),
        ("dir_X", 1, 0, "lead away from the surface by `dir_X`"),
        ("dir_X", 20, 0, "lead away from the surface by `dir_X`"),
    ] {
        let folder = temporary();
        let at = folder.path();
        let recipe = negated(of_parts("first-steps", "fit"), at, (column, copies));
        for rows in [None, Some(60), Some(20_000)] {
            let recipe = Variant(recipe.0.clone());
            rows.map_or(Variant(recipe.0.clone()), |rows: usize| recipe.set("touches", "batch_rows", json!(rows)))
                .write(at);
            let printed = run(at, "out");
            let told = printed.stderr.split_whitespace().collect::<Vec<_>>().join(" ");
            assert_eq!(printed.status, status, "{column}, {copies}, {rows:?}: {told}");
            assert!(told.contains(said), "{column}, {copies}, {rows:?}: {told}");
            let checked = as_typed(at, &["check", "recipe.yaml"]);
            assert!(status == 1 || checked.stdout.contains("lead away"), "{column}, {copies}, {rows:?}: {checked:?}");
            let found = calibration(at, "out", "fit");
            assert_eq!(found.fit.implausible.is_empty(), status == 0, "{column}, {copies}, {rows:?}");
        }
    }
}

#[test]
fn good_rows_in_batches_get_no_word() {
    let folder = temporary();
    let at = folder.path();
    let recipe = negated(of_parts("first-steps", "fit"), at, ("none", 20));
    recipe.set("touches", "batch_rows", json!(1000)).write(at);
    let printed = run(at, "out");
    assert_eq!(printed.status, 0, "{}", printed.stderr);
    for word in ["lead away", "away from contact", "no machine", "large", "touched at"] {
        assert!(!printed.stderr.contains(word), "{word}: {}", printed.stderr);
    }
}
