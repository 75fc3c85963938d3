//! Columns of the tables of a run folder.

/// One column of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ColumnSpec {
    /// Name, with the unit in it.
    pub name: &'static str,
    /// Unit; `1` for a pure number.
    pub unit: &'static str,
    /// Contents of the column, in words.
    pub doc: &'static str,
}

/// Columns of a spectrum.
pub const SPECTRUM_COLUMNS: &[ColumnSpec] = &[
    ColumnSpec {
        name: "freq_hz",
        unit: "Hz",
        doc: "frequency",
    },
    ColumnSpec {
        name: "z_re_ohm",
        unit: "Ω",
        doc: "real part of the impedance",
    },
    ColumnSpec {
        name: "z_im_ohm",
        unit: "Ω",
        doc: "imaginary part of the impedance",
    },
    ColumnSpec {
        name: "sigma_re_ohm",
        unit: "Ω",
        doc: "standard deviation of the real part; NaN if unknown",
    },
    ColumnSpec {
        name: "sigma_im_ohm",
        unit: "Ω",
        doc: "standard deviation of the imaginary part; NaN if unknown",
    },
    ColumnSpec {
        name: "cov_re_im_ohm2",
        unit: "Ω²",
        doc: "covariance of real and imaginary part; NaN if unknown",
    },
    ColumnSpec {
        name: "amplitude_a",
        unit: "A",
        doc: "amplitude of the current, zero to peak; NaN if unknown",
    },
];

/// Columns behind those of a spectrum that was measured under a direct current.
pub const CONDITION_COLUMNS: &[ColumnSpec] = &[
    ColumnSpec {
        name: "bias_a",
        unit: "A",
        doc: "commanded direct current under the sinusoid, charge positive",
    },
    ColumnSpec {
        name: "bias_measured_a",
        unit: "A",
        doc: "measured direct current",
    },
    ColumnSpec {
        name: "sigma_bias_a",
        unit: "A",
        doc: "standard deviation of the measured direct current",
    },
    ColumnSpec {
        name: "charge_c",
        unit: "C",
        doc: "charge that the direct current has moved since the rest before the sweep",
    },
    ColumnSpec {
        name: "temperature_c",
        unit: "°C",
        doc: "temperature of the cell's surface; NaN if not measured",
    },
];

/// Columns of a time series.
pub const SERIES_COLUMNS: &[ColumnSpec] = &[
    ColumnSpec {
        name: "time_s",
        unit: "s",
        doc: "bench time",
    },
    ColumnSpec {
        name: "voltage_v",
        unit: "V",
        doc: "voltage of the cell; NaN if not measured",
    },
    ColumnSpec {
        name: "current_a",
        unit: "A",
        doc: "current into the cell, charge positive; NaN if not measured",
    },
    ColumnSpec {
        name: "temperature_c",
        unit: "°C",
        doc: "temperature of the cell's surface; NaN if not measured",
    },
];

/// Columns of a trace: those of BDF (battery data format), and the number of samples in the mean of
/// a row.
pub const TRACE_COLUMNS: &[ColumnSpec] = &[
    ColumnSpec {
        name: "Test Time / s",
        unit: "s",
        doc: "time since the start of the trace",
    },
    ColumnSpec {
        name: "Current / A",
        unit: "A",
        doc: "current into the cell, charge positive",
    },
    ColumnSpec {
        name: "Voltage / V",
        unit: "V",
        doc: "voltage of the cell",
    },
    ColumnSpec {
        name: "Surface Temperature T1 / degC",
        unit: "°C",
        doc: "temperature of the cell's surface; NaN if not measured",
    },
    ColumnSpec {
        name: "Averaged Samples / 1",
        unit: "1",
        doc: "samples of the scope that current and voltage are the mean of",
    },
    ColumnSpec {
        name: "Averaged From / s",
        unit: "s",
        doc: "start of that mean, in test time; NaN if unknown",
    },
    ColumnSpec {
        name: "Averaged To / s",
        unit: "s",
        doc: "its end",
    },
];

/// Columns of a leg of direct current: those of BDF, and the charge.
pub const LEG_COLUMNS: &[ColumnSpec] = &[
    ColumnSpec {
        name: "Test Time / s",
        unit: "s",
        doc: "time since the start of the first leg",
    },
    ColumnSpec {
        name: "Current / A",
        unit: "A",
        doc: "current into the cell, charge positive",
    },
    ColumnSpec {
        name: "Voltage / V",
        unit: "V",
        doc: "voltage at the load's sense terminals",
    },
    ColumnSpec {
        name: "Surface Temperature T1 / degC",
        unit: "°C",
        doc: "temperature of the cell's surface; NaN if not measured",
    },
    ColumnSpec {
        name: "Charge / C",
        unit: "C",
        doc: "charge that has flowed into the cell since the start of the first leg",
    },
];

/// The column of the reasons for which a gate refused a point, in a CSV header.
pub const FLAGS: &str = ",flags";

/// The same in Parquet.
pub(super) const FLAGS_COLUMN: ColumnSpec = ColumnSpec {
    name: "flags",
    unit: "1",
    doc: "why a quality gate refused the point; empty for the others",
};
