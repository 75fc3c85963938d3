//! Names of the columns of a record in the programs that write them, and their units.

/// Names of a quantity without blanks and punctuation, the most reliable first, and its units.
pub(super) struct Names {
    pub(super) names: &'static [&'static str],
    pub(super) units: &'static [(&'static str, f64)],
    /// Ambiguous names, which require a unit.
    pub(super) short: &'static [&'static str],
}

/// Time, s.
pub(super) static TIME: Names = Names {
    names: &[
        "testtime",
        "cumulativetime",
        "totaltime",
        "runtime",
        "progtime",
        "programtime",
        "elapsedtime",
        "elapsed",
        "test",
        "prüfzeit",
        "testzeit",
        "gesamtzeit",
        "programmdauer",
        "progrzeit",
        "laufzeit",
        "总时间",
        "累计时间",
        "测试时间",
        "tempstotal",
        "time",
        "zeit",
        "temps",
        "时间",
        "recordtime",
        "timedomain",
        "passtime",
        "t",
    ],
    units: &[
        ("s", 1.0),
        ("sec", 1.0),
        ("secs", 1.0),
        ("second", 1.0),
        ("seconds", 1.0),
        ("sekunden", 1.0),
        ("ms", 1.0e-3),
        ("millisecond", 1.0e-3),
        ("milliseconds", 1.0e-3),
        ("us", 1.0e-6),
        ("µs", 1.0e-6),
        ("min", 60.0),
        ("mins", 60.0),
        ("minute", 60.0),
        ("minutes", 60.0),
        ("h", 3600.0),
        ("hr", 3600.0),
        ("hrs", 3600.0),
        ("hour", 3600.0),
        ("hours", 3600.0),
        ("decimalhours", 3600.0),
        ("stunden", 3600.0),
        ("d", 86_400.0),
        ("day", 86_400.0),
        ("days", 86_400.0),
    ],
    short: &["test", "t", "elapsed"],
};

/// Voltage, V.
pub(super) static VOLTAGE: Names = Names {
    names: &[
        "voltage",
        "ewe",
        "ecell",
        "cellvoltage",
        "volts",
        "potential",
        "spannung",
        "zellspannung",
        "tension",
        "电压",
        "ucell",
        "vcell",
        "terminalvoltage",
        "batteryvoltage",
        "packvoltage",
        "measuredvoltage",
        "voltagemeasured",
        "we(1)potential",
        "potential(ac)",
        "vf",
        "u",
        "v",
        "e",
    ],
    units: &[
        ("v", 1.0),
        ("volt", 1.0),
        ("volts", 1.0),
        ("vvsref", 1.0),
        ("mv", 1.0e-3),
        ("millivolt", 1.0e-3),
        ("µv", 1.0e-6),
        ("uv", 1.0e-6),
    ],
    short: &["vf", "u", "v", "e"],
};

/// Current, A.
pub(super) static CURRENT: Names = Names {
    names: &[
        "current",
        "i",
        "amps",
        "strom",
        "courant",
        "电流",
        "cellcurrent",
        "batterycurrent",
        "packcurrent",
        "measuredcurrent",
        "currentmeasured",
        "we(1)current",
        "current(ac)",
        "im",
    ],
    units: &[
        ("a", 1.0),
        ("amp", 1.0),
        ("amps", 1.0),
        ("ampere", 1.0),
        ("amperes", 1.0),
        ("ma", 1.0e-3),
        ("milliampere", 1.0e-3),
        ("µa", 1.0e-6),
        ("ua", 1.0e-6),
    ],
    short: &["i", "im"],
};

/// Temperature, °C.
pub(super) static TEMPERATURE: Names = Names {
    names: &[
        "surfacetemperaturet1",
        "temperaturet1",
        "auxtemperature1",
        "auxtemperature",
        "celltemperature",
        "celltemp",
        "batterytemperature",
        "batterytemp",
        "surfacetemperature",
        "temperaturemeasured",
        "temperature",
        "temperatur",
        "température",
        "温度",
        "temp",
        "temperature1",
        "temp1",
        "t1",
    ],
    units: CELSIUS,
    short: &["t1"],
};

const CELSIUS: &[(&str, f64)] = &[
    ("c", 1.0),
    ("°c", 1.0),
    ("℃", 1.0),
    ("degc", 1.0),
    ("celsius", 1.0),
    ("degreesc", 1.0),
];

/// Temperature of the chamber, °C.
pub(super) static AMBIENT: Names = Names {
    names: &[
        "ambienttemperature",
        "ambienttemp",
        "chambertemperature",
        "chambertemp",
        "climatechambertemperature",
        "environmenttemperature",
        "envtemperature",
        "umgebungstemperatur",
        "kammertemperatur",
        "环境温度",
    ],
    units: CELSIUS,
    short: &[],
};

const FRACTION: &[(&str, f64)] = &[("1", 1.0), ("%", 0.01), ("percent", 0.01), ("pct", 0.01)];

/// State of charge, 0 to 1.
pub(super) static SOC: Names = Names {
    names: &["soc", "soc%", "stateofcharge", "ladezustand"],
    units: FRACTION,
    short: &[],
};

/// Depth of discharge, 0 to 1.
pub(super) static DOD: Names = Names {
    names: &["dod", "dod%", "depthofdischarge", "entladetiefe"],
    units: FRACTION,
    short: &[],
};

const CAPACITY_UNITS: &[(&str, f64)] = &[("ah", 1.0), ("mah", 1.0e-3), ("amperehour", 1.0)];

/// Charge into the cell less charge out of it, Ah.
pub(super) static NET: Names = Names {
    names: &["netcapacity"],
    units: CAPACITY_UNITS,
    short: &["netcapacity"],
};

/// Charge into the cell, Ah.
pub(super) static CHARGE: Names = Names {
    names: &[
        "chargecapacity",
        "chargingcapacity",
        "schedulechargingcapacity",
        "cyclechargingcapacity",
        "stepchargingcapacity",
        "chgcap",
        "capchg",
        "qcharge",
        "充电容量",
    ],
    units: CAPACITY_UNITS,
    short: &[],
};

/// Charge out of the cell, Ah.
pub(super) static DISCHARGE: Names = Names {
    names: &[
        "dischargecapacity",
        "dischargingcapacity",
        "scheduledischargingcapacity",
        "cycledischargingcapacity",
        "stepdischargingcapacity",
        "dchgcap",
        "capdchg",
        "qdischarge",
        "放电容量",
    ],
    units: CAPACITY_UNITS,
    short: &[],
};

/// Counted charge without direction, Ah.
pub(super) static CAPACITY: Names = Names {
    names: &[
        "capacity",
        "cap",
        "amphr",
        "ahaccu",
        "(qqo)",
        "kapazität",
        "容量",
    ],
    units: CAPACITY_UNITS,
    short: &[],
};

/// A wall clock; the magnitude of a number determines its unit.
pub(super) static WALL: Names = Names {
    names: &[
        "unixtime",
        "dpttime",
        "absolutetime",
        "abstime",
        "datetime",
        "dateandtime",
        "timestamp",
        "realtime",
        "systemtime",
        "zeitstempel",
        "datumuhrzeit",
        "绝对时间",
        "系统时间",
        "date",
        "datum",
    ],
    units: &[("s", 1.0), ("second", 1.0), ("ms", 1.0), ("time", 1.0)],
    short: &[],
};

/// Number of the step of the program.
pub(super) static STEP: Names = Names {
    names: &[
        "stepindex",
        "stepnumber",
        "pgmstep",
        "programstep",
        "stepcount",
        "stepid",
        "stepno",
        "stepnr",
        "step",
        "ns",
        "schrittnr",
        "schritt",
        "工步号",
        "工步序号",
    ],
    units: &[("1", 1.0)],
    short: &[],
};

/// Names of columns with a word for the direction of the current.
pub(super) const STATES: [&str; 17] = [
    "steptype",
    "state",
    "md",
    "status",
    "stepstate",
    "stepname",
    "steptypename",
    "chgdchg",
    "mode",
    "command",
    "steptext",
    "zustand",
    "stepdescription",
    "工步类型",
    "工步状态",
    "状态",
    "step",
];
