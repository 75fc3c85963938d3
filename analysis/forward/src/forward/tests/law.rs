use super::*;
use proptest::prelude::*;

fn drive(beyond: Beyond, r_ohm: f64) -> Drive {
    Drive {
        demand: Demand::Power,
        beyond,
        r_ohm,
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(128))]

    #[test]
    fn the_larger_root_delivers_the_power(e in 0.5..70.0f64, r in 1e-3..0.1f64, share in -3.0..0.999f64) {
        let d = drive(Beyond::Stop, r);
        let p = share * d.available_w(e);
        let i = d.reply(e, p).current_a;
        let ccv = e - r * i;
        prop_assert!((ccv * i - p).abs() < 1e-9 * p.abs().max(1e-3) && ccv >= 0.5 * e - 1e-9);
    }

    #[test]
    fn the_tangent_joins_with_its_derivative_and_goes_on_to_any_power(
        e in 0.5..70.0f64,
        r in 1e-3..0.1f64,
        fraction in 0.3..0.999f64,
    ) {
        let d = drive(Beyond::Extrapolate { fraction }, r);
        let p0 = fraction * d.available_w(e);
        let ccv = |p: f64| e - r * d.reply(e, p).current_a;
        // Straight from the thesis: V(P) and its derivative at P₀.
        let root = (e * e - 4.0 * p0 * r).sqrt();
        let (v0, slope) = (0.5 * (e + root), -r / root);
        for factor in [1.0 + 1e-9, 1.3, 2.0, 50.0] {
            let p = p0 * factor;
            let line = v0 + slope * (p - p0);
            prop_assert!(
                (ccv(p) - line).abs() < 1e-9 * line.abs().max(e),
                "{} against {}",
                ccv(p),
                line
            );
        }
        let (below, above) = (
            d.reply(e, p0 * (1.0 - 1e-12)),
            d.reply(e, p0 * (1.0 + 1e-12)),
        );
        for (a, b) in [
            (below.current_a, above.current_a),
            (below.d_e, above.d_e),
            (below.d_demand, above.d_demand),
            (below.d_r, above.d_r),
        ] {
            prop_assert!(
                (a - b).abs() < 1e-6 * a.abs().max(b.abs()),
                "{:?} {:?}",
                below,
                above
            );
        }
    }

    #[test]
    fn the_bend_joins_with_its_curvature_and_ends_as_a_line_at_the_most_power(
        e in 0.5..70.0f64,
        r in 1e-3..0.1f64,
        fraction in 0.3..0.99f64,
    ) {
        let d = drive(Beyond::Bend { fraction }, r);
        let most = d.available_w(e);
        // CCV in half E over the power in P*, and its derivative.
        let ccv = |x: f64| 2.0 - 2.0 * r / e * d.reply(e, x * most).current_a;
        let slope = |x: f64| -2.0 * r / e * d.reply(e, x * most).d_demand * most;
        let c = (1.0 - fraction).sqrt();
        prop_assert!((ccv(fraction * (1.0 + 1e-12)) - 1.0 - c).abs() < 1e-9);
        let step = 1e-4 * (1.0 - fraction);
        let curvature = (slope(fraction + step) - slope(fraction - step)) / (2.0 * step);
        prop_assert!((curvature * 4.0 * c.powi(3) + 1.0).abs() < 1e-3, "{}", curvature);
        prop_assert!((ccv(1.0) - 1.0 - 5.0 * c / 12.0).abs() < 1e-9);
        for x in [1.0, 1.0 + 1e-9, 2.0, 50.0] {
            prop_assert!((slope(x) * 8.0 * c + 5.0).abs() < 1e-6, "{}", slope(x));
        }
    }

    #[test]
    fn derivatives_are_difference_quotients(
        e in 1.0..60.0f64,
        r in 2e-3..0.1f64,
        share in -2.0..3.0f64,
        kind in 0..4usize,
    ) {
        let (tangent, bend) = (
            Beyond::Extrapolate { fraction: 0.9 },
            Beyond::Bend { fraction: 0.9 },
        );
        let d = Drive {
            demand: [Demand::Power, Demand::Current, Demand::Resistance, Demand::Power][kind],
            ..drive([tangent, tangent, tangent, bend][kind], r)
        };
        let demand = match kind {
            0 | 3 => share * d.available_w(e),
            1 => 100.0 * share,
            _ => share.abs() + 0.01,
        };
        // At the joint the second derivative jumps; a quotient over it means little.
        prop_assume!((share - 0.9).abs() > 0.02);
        let at = d.reply(e, demand);
        let (he, hd, hr) = (1e-6 * e, 1e-6 * demand.abs().max(1e-3), 1e-6 * r);
        let i = |e: f64, demand: f64, r: f64| Drive { r_ohm: r, ..d }.reply(e, demand).current_a;
        let quotients = [
            (i(e + he, demand, r) - i(e - he, demand, r)) / (2.0 * he),
            (i(e, demand + hd, r) - i(e, demand - hd, r)) / (2.0 * hd),
            (i(e, demand, r + hr) - i(e, demand, r - hr)) / (2.0 * hr),
        ];
        let scale = [
            at.current_a.abs() / e,
            at.current_a.abs() / demand.abs().max(1e-3),
            at.current_a.abs() / r,
        ];
        for ((met, quotient), scale) in [at.d_e, at.d_demand, at.d_r]
            .into_iter()
            .zip(quotients)
            .zip(scale)
        {
            prop_assert!(
                (met - quotient).abs() < 1e-5 * (quotient.abs() + scale),
                "{:?}: {} against {}",
                d,
                met,
                quotient
            );
        }
    }
}
