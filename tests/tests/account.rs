//! Every formula keeps to the error that its row of `docs/numerics.md` allows it.

use heliosplat_tests::account;

#[test]
fn every_formula_keeps_to_its_limit() {
    let rows = account::rows(false);
    rows.iter().for_each(|row| println!("{}", row.markdown()));
    let faults: Vec<String> = rows.iter().filter_map(account::Row::fault).collect();
    assert!(
        faults.is_empty(),
        "{} formulas fail:\n{}",
        faults.len(),
        faults.join("\n")
    );
    assert!(rows.len() >= 20);
}

#[test]
fn the_naive_forms_are_worse_where_it_matters() {
    // Lanes are for speed, and the clamp of Adam for later steps; the others must gain something.
    let for_speed = ["`exp` in lanes", "`ln` in lanes", "`2^x`"];
    for row in account::rows(false)
        .iter()
        .filter(|row| !for_speed.iter().any(|name| row.formula.starts_with(name)))
    {
        let worse = |robust: &account::Worst, naive: &account::Worst| {
            naive.broken.is_some() || naive.error > 2.0 * robust.error
        };
        let by_value = worse(&row.robust.value, &row.naive.value);
        let by_gradient = match (&row.robust.gradient, &row.naive.gradient) {
            (Some(robust), Some(naive)) => worse(robust, naive),
            _ => false,
        };
        let unmeasured = row.naive.value.at.is_empty() && row.naive.value.broken.is_none();
        assert!(by_value || by_gradient || unmeasured, "{}: nothing gained", row.formula);
    }
}
