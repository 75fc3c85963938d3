//! Porous electrodes as transmission lines: impedance of a pore and its derivatives.
//!
//! A pore of the ionic resistance R has the admittance y per pore from its wall to the conductor.
//! With q² = R·y the impedance at its mouth is R·F(q²), and F depends on the end of the pore:
//! coth(q)/q for a wall that is closed, tanh(q)/q for one that is short, and between them for an
//! end with its own impedance (Bisquert et al., Phys. Chem. Chem. Phys. 2 (2000) 4185, equations 8
//! and 16; one rail without resistance).

use super::hyperbolic::{coth, csch, csch_squared, tanh_over};
use num_complex::Complex64;

/// End of a pore.
#[derive(Debug, Clone, Copy)]
pub(super) enum End {
    /// Nothing passes.
    Closed,
    /// No impedance to the conductor.
    Short,
    /// An impedance in Ω to the conductor.
    Through(Complex64),
}

/// Impedance in Ω of a pore, with its derivatives.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pore {
    pub(super) z: Complex64,
    /// With respect to the ionic resistance.
    pub(super) by_resistance: Complex64,
    /// With respect to the admittance of the wall.
    pub(super) by_admittance: Complex64,
    /// With respect to the impedance of the end; zero if it has none.
    pub(super) by_end: Complex64,
}

impl Pore {
    /// Pore of an ionic resistance in Ω, an admittance of its wall in S, and an end.
    pub(super) fn of(r_ohm: f64, wall_s: Complex64, end: End) -> Self {
        let square = r_ohm * wall_s;
        let q = square.sqrt();
        // The function, its derivative by the logarithm of q², and by the end over R.
        let (value, slope, by_ratio, ratio) = match end {
            End::Closed => {
                let quotient = coth(q) / q;
                let slope = -0.5 * (csch_squared(q) + quotient);
                (quotient, slope, Complex64::ZERO, Complex64::ZERO)
            }
            End::Short => {
                let (quotient, slope) = tanh_over(q);
                (quotient, 0.5 * slope, Complex64::ZERO, Complex64::ZERO)
            }
            End::Through(end_ohm) => {
                // With t = tanh(q)/q and b = end/R: F = (b + t)/(1 + b·q²·t).
                let b = end_ohm / r_ohm;
                let (t, slope) = tanh_over(q);
                let below = (1.0 + b * square * t).inv();
                let value = (b + t) * below;
                let by_ratio = (1.0 - square * t * t) * below * below;
                let slope =
                    ((1.0 - b * b * square) * 0.5 * slope * below - value * b * square * t) * below;
                (value, slope, by_ratio, b)
            }
        };
        Self {
            z: r_ohm * value,
            by_resistance: value + slope - ratio * by_ratio,
            by_admittance: r_ohm * slope / wall_s,
            by_end: by_ratio,
        }
    }
}

/// Returns the impedance A·coth(β)/β + B/(β·sinh β) with β² = a + s·b of an electrode whose
/// conductor and pore both resist (Paasch et al., Electrochim. Acta 38 (1993) 2653), for the
/// parameters A, B, a and b.
pub(super) fn macrohomogeneous(p: [f64; 4], s: Complex64, slopes: &mut [Complex64]) -> Complex64 {
    let [level_a, level_b, a, b] = p;
    let square = a + s * b;
    let beta = square.sqrt();
    let (cotangent, cosecant) = (coth(beta) / beta, csch(beta) / beta);
    let by_square = (-0.5 * level_a * (csch_squared(beta) + cotangent)
        - 0.5 * level_b * cosecant * (1.0 + beta * coth(beta)))
        / square;
    slopes.copy_from_slice(&[cotangent, cosecant, by_square, s * by_square]);
    level_a * cotangent + level_b * cosecant
}
