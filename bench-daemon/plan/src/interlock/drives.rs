//! The instruments that can drive a current and measure it themselves.

/// Instruments that have a meter of their own current, in the order of [`Drive::ALL`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Drive {
    /// The bipolar supply; a charge current is positive.
    Supply4q,
    /// The load; the current that it draws is positive.
    Load,
    /// The charger; the current that it delivers is positive.
    Supply,
}

impl Drive {
    /// Every drive.
    pub const ALL: [Self; 3] = [Self::Supply4q, Self::Load, Self::Supply];

    /// Returns the name of its role in the bench file.
    pub const fn role(self) -> &'static str {
        match self {
            Self::Supply4q => "supply4q",
            Self::Load => "load",
            Self::Supply => "supply",
        }
    }

    /// Checks whether its meter measures the voltage of the cell itself: the leads of the load do,
    /// and those of the bipolar supply on a bench without a load.
    pub fn reads_cell(self, has_load: bool) -> bool {
        match self {
            Self::Load => true,
            Self::Supply4q => !has_load,
            Self::Supply => false,
        }
    }

    /// Returns the quantity that its meter shows, for messages.
    pub const fn current(self) -> &'static str {
        match self {
            Self::Supply4q => "current of the bipolar supply",
            Self::Load => "current of the load",
            Self::Supply => "current of the charger",
        }
    }
}

/// The drives that a step uses; all others must carry no current.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Drives {
    /// The bipolar supply.
    pub supply4q: bool,
    /// The load.
    pub load: bool,
    /// The charger.
    pub supply: bool,
}

impl Drives {
    /// The bipolar supply alone.
    pub const SUPPLY4Q: Self = Self {
        supply4q: true,
        load: false,
        supply: false,
    };
    /// The load alone.
    pub const LOAD: Self = Self {
        supply4q: false,
        load: true,
        supply: false,
    };
    /// The charger alone.
    pub const SUPPLY: Self = Self {
        supply4q: false,
        load: false,
        supply: true,
    };
    /// Load and charger alternately.
    pub const LOAD_AND_SUPPLY: Self = Self {
        supply4q: false,
        load: true,
        supply: true,
    };

    /// Checks whether the step uses a drive.
    pub fn uses(self, drive: Drive) -> bool {
        match drive {
            Drive::Supply4q => self.supply4q,
            Drive::Load => self.load,
            Drive::Supply => self.supply,
        }
    }
}
