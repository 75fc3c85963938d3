use super::*;

#[test]
fn the_peak_is_of_what_is_applied() {
    let peak = |interpolation, list: &[(f64, f64)]| rows(Demand::Power, interpolation, list).peak();
    assert_eq!(
        peak(Interpolation::Hold, &[(0.0, 100.0), (1.0, 500.0)]),
        Some(100.0)
    );
    assert_eq!(
        peak(Interpolation::Linear, &[(0.0, 100.0), (1.0, 500.0)]),
        Some(500.0)
    );
    assert_eq!(
        peak(
            Interpolation::Hold,
            &[(0.0, -100.0), (1.0, -30.0), (2.0, 0.0)]
        ),
        Some(-100.0)
    );
    assert_eq!(
        peak(
            Interpolation::Hold,
            &[(0.0, -100.0), (1.0, 30.0), (2.0, 0.0)]
        ),
        Some(30.0)
    );
    assert_eq!(peak(Interpolation::Hold, &[(0.0, 0.0), (1.0, 30.0)]), None);
}

#[test]
fn the_state_of_charge_may_leave_its_range_and_says_so() {
    let model = curved_cell();
    // 4.2 Ah: 4.2 A for 0.2 h from 0.1 end at −0.1.
    let profile = Profile::constant(Demand::Current, 4.2, 720.0).unwrap();
    let s = simulate(
        &model,
        &model.rest(0.1).unwrap(),
        &profile,
        &SimOptions::default(),
    )
    .unwrap()
    .summary;
    assert!(
        (s.soc_min.unwrap() + 0.1).abs() < 1e-9 && (s.soc_max.unwrap() - 0.1).abs() < 1e-9,
        "{s:?}"
    );
    let flat = flat_cell();
    let s = simulate(
        &flat,
        &flat.rest(0.5).unwrap(),
        &profile,
        &SimOptions::default(),
    )
    .unwrap()
    .summary;
    assert_eq!((s.soc_min, s.soc_max), (None, None));
}
