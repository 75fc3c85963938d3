//! The elements of a circuit: impedance and exact derivatives with respect to each parameter.
//!
//! Names, order of parameters and formulas are impedance.py's
//! (`impedance/models/circuits/elements.py`, version 1.7), with s = jω:
//!
//! | element | parameters | impedance |
//! |---|---|---|
//! | `R` | R / Ω | R |
//! | `C` | C / F | 1/(Cs) |
//! | `L` | L / H | Ls |
//! | `La` | L / Ω sᵅ, α | L·sᵅ |
//! | `W` | A / Ω s^-½ | A(1 − j)/√ω |
//! | `Wo` | Z₀ / Ω, τ / s | Z₀·coth(√(sτ))/√(sτ) |
//! | `Ws` | Z₀ / Ω, τ / s | Z₀·tanh(√(sτ))/√(sτ) |
//! | `CPE` | Q / Ω⁻¹ sᵅ, α | 1/(Q·sᵅ) |
//! | `G` | R / Ω, t / s | R/√(1 + st) |
//! | `Gs` | R / Ω, t / s, φ | R/(√(1 + st)·tanh(φ√(1 + st))) |
//! | `K` | R / Ω, τ / s | R/(1 + sτ) |
//! | `Zarc` | R / Ω, τ / s, γ | R/(1 + (sτ)ᵞ) |
//! | `TLMQ` | R / Ω, Q / Ω⁻¹ sᵞ, γ | R·coth(q)/q, q² = R·Q·sᵞ |
//! | `T` | A / Ω, B / Ω, a, b / s | A·coth(β)/β + B/(β·sinh β), β² = a + sb |
//!
//! Relaxations and pores that impedance.py lacks have pyimpspec's names (version 5.1). Its pores
//! have a length beside their resistance; no spectrum can separate the two, so here R is that of
//! the whole pore, R′ and Q those of its whole wall:
//!
//! | element | parameters | impedance |
//! |---|---|---|
//! | `Ga` | R / Ω, τ / s, n | R/(1 + sτ)ⁿ |
//! | `Ha` | R / Ω, τ / s, a, b | R/(1 + (sτ)ᵃ)ᵇ |
//! | `H` | C / F, τ / s, a, b | (1 + (sτ)ᵃ)ᵇ/(Cs) |
//! | `Tlmbs` | R / Ω, Q / Ω⁻¹ sᵞ, γ | R·tanh(q)/q, q² = R·Q·sᵞ |
//! | `Tlmbq` | R / Ω, Q / Ω⁻¹ sᵞ, γ, Q₂ / Ω⁻¹ sᵟ, δ | the same with the end 1/(Q₂·sᵟ) |
//! | `Ls` | R / Ω, R′ / Ω, Q / Ω⁻¹ sᵞ, γ | R·coth(q)/q, q² = R·(1/R′ + Q·sᵞ) |
//! | `Tlmns` | R / Ω, R′ / Ω, Q / Ω⁻¹ sᵞ, γ | R·tanh(q)/q, q² = R·(1/R′ + Q·sᵞ) |
//! | `Tlmnq` | R, R′, Q, γ, R₂ / Ω, Q₂ / Ω⁻¹ sᵟ, δ | the same with the end R₂/(1 + R₂·Q₂·sᵟ) |
//!
//! `La` is as impedance.py and BioLogic's application note 42 document it. impedance.py's code
//! computes (L·s)ᵅ instead: its L is ours to the power of 1/α; with α = 1 they agree.

use super::hyperbolic::{coth, csch_squared, tanh_over};
use super::porous::{End, Pore, macrohomogeneous};
use num_complex::Complex64;
use std::f64::consts::{FRAC_1_SQRT_2, FRAC_PI_2};

/// Most parameters of one element.
pub(crate) const MAX_PARAMETERS: usize = 7;

/// A kind of element.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ElementKind {
    /// Resistor.
    R,
    /// Capacitor.
    C,
    /// Inductor.
    L,
    /// Lossy inductor.
    La,
    /// Semi-infinite Warburg diffusion.
    W,
    /// Finite diffusion with a blocking end (open).
    Wo,
    /// Finite diffusion with a permeable end (short).
    Ws,
    /// Constant phase element.
    Cpe,
    /// Gerischer element.
    G,
    /// Gerischer element of finite length.
    Gs,
    /// Resistor and capacitor in parallel, by their time constant.
    K,
    /// Resistor and constant phase element in parallel, by their time constant.
    Zarc,
    /// Blocking pore, closed at its end.
    Tlmq,
    /// Porous electrode whose conductor resists too.
    T,
    /// Gerischer element with a free exponent.
    Ga,
    /// Havriliak–Negami relaxation of a resistance.
    Ha,
    /// Havriliak–Negami relaxation of a capacitance.
    H,
    /// Blocking pore, short at its end.
    Tlmbs,
    /// Blocking pore with a constant phase element at its end.
    Tlmbq,
    /// Pore with charge transfer, closed at its end (de Levie).
    Ls,
    /// Pore with charge transfer, short at its end.
    Tlmns,
    /// Pore with charge transfer, and a resistor beside a constant phase element at its end.
    Tlmnq,
}

/// Effect of a parameter on the impedance of its element.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Role {
    /// The impedance is proportional to it.
    Level,
    /// The impedance is inversely proportional to it.
    InverseLevel,
    /// A time in seconds that scales the frequency.
    Time,
    /// An exponent of the frequency, 0…1.
    Exponent,
    /// A dimensionless length above zero.
    Length,
}

/// One parameter of a kind of element.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ParameterKind {
    /// Unit as text; empty for a pure number.
    pub unit: &'static str,
    /// Effect of the parameter on the impedance.
    pub role: Role,
    /// Physical range (lower, upper), far wider than any cell's.
    pub bounds: (f64, f64),
}

const fn parameter(unit: &'static str, role: Role, lower: f64, upper: f64) -> ParameterKind {
    ParameterKind {
        unit,
        role,
        bounds: (lower, upper),
    }
}

const OHM: ParameterKind = parameter("Ω", Role::Level, 1e-12, 1e12);
const TIME: ParameterKind = parameter("s", Role::Time, 1e-15, 1e15);
const EXPONENT: ParameterKind = parameter("", Role::Exponent, 0.05, 1.0);

impl ElementKind {
    /// Every kind, in the order of the table above.
    pub const ALL: [Self; 22] = [
        Self::R,
        Self::C,
        Self::L,
        Self::La,
        Self::W,
        Self::Wo,
        Self::Ws,
        Self::Cpe,
        Self::G,
        Self::Gs,
        Self::K,
        Self::Zarc,
        Self::Tlmq,
        Self::T,
        Self::Ga,
        Self::Ha,
        Self::H,
        Self::Tlmbs,
        Self::Tlmbq,
        Self::Ls,
        Self::Tlmns,
        Self::Tlmnq,
    ];

    /// Returns the name in a circuit's string.
    pub fn name(self) -> &'static str {
        match self {
            Self::R => "R",
            Self::C => "C",
            Self::L => "L",
            Self::La => "La",
            Self::W => "W",
            Self::Wo => "Wo",
            Self::Ws => "Ws",
            Self::Cpe => "CPE",
            Self::G => "G",
            Self::Gs => "Gs",
            Self::K => "K",
            Self::Zarc => "Zarc",
            Self::Tlmq => "TLMQ",
            Self::T => "T",
            Self::Ga => "Ga",
            Self::Ha => "Ha",
            Self::H => "H",
            Self::Tlmbs => "Tlmbs",
            Self::Tlmbq => "Tlmbq",
            Self::Ls => "Ls",
            Self::Tlmns => "Tlmns",
            Self::Tlmnq => "Tlmnq",
        }
    }

    /// Its parameters, in impedance.py's order.
    pub fn parameters(self) -> &'static [ParameterKind] {
        const LENGTH: ParameterKind = parameter("", Role::Length, 1e-4, 1e4);
        const FARAD: ParameterKind = parameter("F", Role::InverseLevel, 1e-18, 1e12);
        const Q: ParameterKind = parameter("Ω^-1 s^α", Role::InverseLevel, 1e-18, 1e12);
        match self {
            Self::R => &[OHM],
            Self::C => &[FARAD],
            Self::L => const { &[parameter("H", Role::Level, 1e-18, 1e6)] },
            Self::La => const { &[parameter("Ω s^α", Role::Level, 1e-18, 1e12), EXPONENT] },
            Self::W => const { &[parameter("Ω s^-1/2", Role::Level, 1e-12, 1e12)] },
            Self::Cpe => const { &[Q, EXPONENT] },
            Self::Wo | Self::Ws | Self::G | Self::K => const { &[OHM, TIME] },
            Self::Gs => const { &[OHM, TIME, LENGTH] },
            Self::Zarc | Self::Ga => const { &[OHM, TIME, EXPONENT] },
            Self::Ha => const { &[OHM, TIME, EXPONENT, EXPONENT] },
            Self::H => const { &[FARAD, TIME, EXPONENT, EXPONENT] },
            Self::T => const { &[OHM, OHM, LENGTH, TIME] },
            Self::Tlmq | Self::Tlmbs => const { &[OHM, Q, EXPONENT] },
            Self::Tlmbq => const { &[OHM, Q, EXPONENT, Q, EXPONENT] },
            Self::Ls | Self::Tlmns => const { &[OHM, OHM, Q, EXPONENT] },
            Self::Tlmnq => const { &[OHM, OHM, Q, EXPONENT, OHM, Q, EXPONENT] },
        }
    }

    /// Returns the resistance in Ω at zero frequency; infinite if the element blocks a direct
    /// current.
    pub fn dc_resistance_ohm(self, p: &[f64]) -> f64 {
        let pore = |transfer: f64, end| {
            Pore::of(p[0], Complex64::new(1.0 / transfer, 0.0), end)
                .z
                .re
        };
        match self {
            Self::C | Self::W | Self::Wo | Self::Cpe | Self::H | Self::Tlmq | Self::Tlmbq => {
                f64::INFINITY
            }
            Self::L | Self::La => 0.0,
            Self::R
            | Self::Ws
            | Self::G
            | Self::K
            | Self::Zarc
            | Self::Ga
            | Self::Ha
            | Self::Tlmbs => p[0],
            Self::Gs => p[0] / p[2].tanh(),
            Self::T => {
                let beta = p[2].sqrt();
                p[0] / (beta * beta.tanh()) + p[1] / (beta * beta.sinh())
            }
            Self::Ls => pore(p[1], End::Closed),
            Self::Tlmns => pore(p[1], End::Short),
            Self::Tlmnq => pore(p[1], End::Through(Complex64::new(p[4], 0.0))),
        }
    }

    /// Impedance in Ω at an angular frequency above zero in rad/s; writes its derivatives with
    /// respect to the parameters to `slopes`.
    ///
    /// Both slices hold as many entries as the kind has parameters, all parameters above zero.
    pub(crate) fn expand(self, p: &[f64], omega: f64, slopes: &mut [Complex64]) -> Complex64 {
        let s = Complex64::new(0.0, omega);
        match (self, p) {
            (Self::R, &[r]) => level(slopes, Complex64::ONE, r),
            (Self::C, &[c]) => inverse_level(slopes, Complex64::new(0.0, -1.0 / (omega * c)), c),
            (Self::L, &[l]) => level(slopes, s, l),
            (Self::W, &[a]) => level(slopes, Complex64::new(1.0, -1.0) / omega.sqrt(), a),
            (Self::La, &[l, alpha]) => {
                let z = level(slopes, power(omega, alpha), l);
                slopes[1] = z * logarithm(omega);
                z
            }
            (Self::Cpe, &[q, alpha]) => {
                let z = inverse_level(slopes, power(omega, -alpha) / q, q);
                slopes[1] = -z * logarithm(omega);
                z
            }
            _ => self.expand_with_time(p, omega, slopes),
        }
    }

    /// As [`ElementKind::expand`], for the kinds that have a time constant.
    fn expand_with_time(self, p: &[f64], omega: f64, slopes: &mut [Complex64]) -> Complex64 {
        let s = Complex64::new(0.0, omega);
        match (self, p) {
            (Self::Wo, &[z0, tau]) => {
                let q = root(omega * tau);
                let quotient = coth(q) / q;
                slopes[1] = (csch_squared(q) + quotient) * (-0.5 * z0 / tau);
                level(slopes, quotient, z0)
            }
            (Self::Ws, &[z0, tau]) => {
                let (quotient, slope) = tanh_over(root(omega * tau));
                slopes[1] = slope * (0.5 * z0 / tau);
                level(slopes, quotient, z0)
            }
            (Self::G, &[r, time]) => {
                let b = (1.0 + s * time).sqrt();
                slopes[1] = -0.5 * r * s / b / b / b;
                level(slopes, b.inv(), r)
            }
            (Self::Gs, &[r, time, phi]) => {
                let b = (1.0 + s * time).sqrt();
                let (coth, csch) = (coth(phi * b), csch_squared(phi * b));
                slopes[1] = -r * (phi * csch + coth / b) / b * (0.5 * s / b);
                slopes[2] = -r * csch;
                level(slopes, coth / b, r)
            }
            (Self::K, &[r, tau]) => {
                let u = (1.0 + s * tau).inv();
                slopes[1] = -r * (s * u) * u;
                level(slopes, u, r)
            }
            (Self::Zarc, &[r, tau, gamma]) => {
                let v = power(omega * tau, gamma);
                let u = (1.0 + v).inv();
                let vuu = v * u * u;
                slopes[1] = vuu * (-r * gamma / tau);
                slopes[2] = -r * vuu * logarithm(omega * tau);
                level(slopes, u, r)
            }
            (Self::Ga, &[r, tau, n]) => {
                let u = 1.0 + s * tau;
                let shape = u.powf(-n);
                slopes[1] = -r * n * s * shape / u;
                slopes[2] = -r * shape * u.ln();
                level(slopes, shape, r)
            }
            (Self::Ha, &[r, tau, a, b]) => {
                let v = power(omega * tau, a);
                let u = 1.0 + v;
                let shape = u.powf(-b);
                let by_v = -r * b * shape / u * v;
                slopes[1] = by_v * (a / tau);
                slopes[2] = by_v * logarithm(omega * tau);
                slopes[3] = -r * shape * u.ln();
                level(slopes, shape, r)
            }
            (Self::H, &[c, tau, a, b]) => {
                let v = power(omega * tau, a);
                let u = 1.0 + v;
                let z = u.powf(b) / (s * c);
                let by_v = b * z / u * v;
                slopes[1] = by_v * (a / tau);
                slopes[2] = by_v * logarithm(omega * tau);
                slopes[3] = z * u.ln();
                inverse_level(slopes, z, c)
            }
            _ => self.expand_pore(p, omega, slopes),
        }
    }

    /// As [`ElementKind::expand`], for porous electrodes.
    fn expand_pore(self, p: &[f64], omega: f64, slopes: &mut [Complex64]) -> Complex64 {
        let cpe = |q: f64, gamma: f64| Storage::of(q, gamma, omega);
        match (self, p) {
            (Self::T, &[a, b, k, time]) => {
                macrohomogeneous([a, b, k, time], Complex64::new(0.0, omega), slopes)
            }
            (Self::Tlmq | Self::Tlmbs, &[r, q, gamma]) => {
                let end = if self == Self::Tlmq {
                    End::Closed
                } else {
                    End::Short
                };
                let wall = cpe(q, gamma);
                let pore = Pore::of(r, wall.admittance, end);
                slopes[0] = pore.by_resistance;
                wall.write(pore.by_admittance, &mut slopes[1..]);
                pore.z
            }
            (Self::Ls | Self::Tlmns, &[r, transfer, q, gamma]) => {
                let end = if self == Self::Ls {
                    End::Closed
                } else {
                    End::Short
                };
                let wall = cpe(q, gamma);
                let pore = Pore::of(r, wall.admittance + 1.0 / transfer, end);
                slopes[0] = pore.by_resistance;
                slopes[1] = -pore.by_admittance / (transfer * transfer);
                wall.write(pore.by_admittance, &mut slopes[2..]);
                pore.z
            }
            (Self::Tlmbq, &[r, q, gamma, q_end, delta]) => {
                let (wall, last) = (cpe(q, gamma), cpe(q_end, delta));
                let end = last.admittance.inv();
                let pore = Pore::of(r, wall.admittance, End::Through(end));
                slopes[0] = pore.by_resistance;
                wall.write(pore.by_admittance, &mut slopes[1..]);
                last.write(-pore.by_end * end * end, &mut slopes[3..]);
                pore.z
            }
            (Self::Tlmnq, &[r, transfer, q, gamma, r_end, q_end, delta]) => {
                let (wall, last) = (cpe(q, gamma), cpe(q_end, delta));
                let end = (last.admittance + 1.0 / r_end).inv();
                let pore = Pore::of(r, wall.admittance + 1.0 / transfer, End::Through(end));
                slopes[0] = pore.by_resistance;
                slopes[1] = -pore.by_admittance / (transfer * transfer);
                wall.write(pore.by_admittance, &mut slopes[2..]);
                let by_admittance = -pore.by_end * end * end;
                slopes[4] = -by_admittance / (r_end * r_end);
                last.write(by_admittance, &mut slopes[5..]);
                pore.z
            }
            // A slice of another length cannot come from a circuit, which gives each element its
            // own parameters.
            _ => Complex64::new(f64::NAN, f64::NAN),
        }
    }
}

/// Admittance Q·sᵞ of a constant phase element.
struct Storage {
    q: f64,
    logarithm: Complex64,
    admittance: Complex64,
}

impl Storage {
    fn of(q: f64, gamma: f64, omega: f64) -> Self {
        Self {
            q,
            logarithm: logarithm(omega),
            admittance: q * power(omega, gamma),
        }
    }

    /// Writes the derivatives with respect to Q and γ, for that of Z by the admittance.
    fn write(&self, by_admittance: Complex64, slopes: &mut [Complex64]) {
        let by_logarithm = by_admittance * self.admittance;
        slopes[0] = by_logarithm / self.q;
        slopes[1] = by_logarithm * self.logarithm;
    }
}

/// Z = p·shape with its derivative, the shape.
fn level(slopes: &mut [Complex64], shape: Complex64, p: f64) -> Complex64 {
    slopes[0] = shape;
    p * shape
}

/// Z, inversely proportional to p, with its derivative −Z/p.
fn inverse_level(slopes: &mut [Complex64], z: Complex64, p: f64) -> Complex64 {
    slopes[0] = -z / p;
    z
}

/// √(jx).
fn root(x: f64) -> Complex64 {
    let part = x.sqrt() * FRAC_1_SQRT_2;
    Complex64::new(part, part)
}

/// (jx)^exponent.
fn power(x: f64, exponent: f64) -> Complex64 {
    Complex64::from_polar(x.powf(exponent), FRAC_PI_2 * exponent)
}

/// ln(jx).
fn logarithm(x: f64) -> Complex64 {
    Complex64::new(x.ln(), FRAC_PI_2)
}
