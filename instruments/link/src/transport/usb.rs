//! USB instruments as the kernel lists them: which `/dev/usbtmcN` has which vendor, product and
//! serial number, and who may open it.

use std::{
    fmt, fs, io,
    os::unix::fs::MetadataExt,
    path::{Path, PathBuf},
    str::FromStr,
};

use nix::unistd::AccessFlags;

/// Where the kernel lists USBTMC devices.
const CLASS: &str = "/sys/class/usbmisc";
/// What a path that names a device, and not its place, begins with.
const ALIAS: &str = "/dev/usbtmc-";

/// Vendor, product and serial number of a USB device.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct UsbName {
    vendor: u16,
    product: u16,
    serial: String,
}

impl UsbName {
    /// Returns the path that stands for the device wherever it is plugged in.
    pub(super) fn alias(&self) -> String {
        let Self {
            vendor,
            product,
            serial,
        } = self;
        format!("{ALIAS}{vendor:04x}-{product:04x}-{serial}")
    }

    fn of_alias(path: &str) -> Option<Self> {
        let mut parts = path.strip_prefix(ALIAS)?.splitn(3, '-');
        Self::of_parts(parts.next()?, parts.next()?, parts.next()?)
    }

    fn of_parts(vendor: &str, product: &str, serial: &str) -> Option<Self> {
        let number = |text: &str| {
            let is_hex = text.len() == 4 && text.bytes().all(|byte| byte.is_ascii_hexdigit());
            is_hex.then(|| u16::from_str_radix(text, 16).ok()).flatten()
        };
        let good = |byte: u8| byte.is_ascii_alphanumeric() || matches!(byte, b'.' | b'_' | b'-');
        (!serial.is_empty() && serial.bytes().all(good)).then_some(())?;
        Some(Self {
            vendor: number(vendor)?,
            product: number(product)?,
            serial: serial.to_owned(),
        })
    }
}

impl FromStr for UsbName {
    type Err = ();

    fn from_str(text: &str) -> Result<Self, ()> {
        let mut parts = text.splitn(3, ':');
        let (vendor, product, serial) = (parts.next(), parts.next(), parts.next());
        Self::of_parts(vendor.ok_or(())?, product.ok_or(())?, serial.ok_or(())?).ok_or(())
    }
}

impl fmt::Display for UsbName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{:04x}:{:04x}:{}",
            self.vendor, self.product, self.serial
        )
    }
}

/// A USBTMC device that is plugged in.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct UsbDevice {
    /// Its file, such as `/dev/usbtmc0`.
    pub file: PathBuf,
    /// Its name; a device without a serial number has none.
    pub name: Option<UsbName>,
    /// Maker and product as the device states them.
    pub title: String,
}

/// Returns the USBTMC devices that are plugged in, by their files.
pub fn usb_devices() -> Vec<UsbDevice> {
    listed(Path::new(CLASS))
}

fn listed(class: &Path) -> Vec<UsbDevice> {
    let entries = fs::read_dir(class).into_iter().flatten().flatten();
    let mut devices: Vec<_> = entries.filter_map(|entry| device(&entry.path())).collect();
    devices.sort_by(|one, other| one.file.cmp(&other.file));
    devices
}

/// Reads an entry of the class: a link to the interface of a device, whose folder is its parent.
fn device(entry: &Path) -> Option<UsbDevice> {
    let file = entry.file_name()?.to_str()?;
    file.strip_prefix("usbtmc")?.parse::<u32>().ok()?;
    let interface = fs::canonicalize(entry.join("device")).ok()?;
    let folder = interface.parent()?;
    let attribute = |name: &str| {
        let text = fs::read_to_string(folder.join(name)).unwrap_or_default();
        text.trim().to_owned()
    };
    let name = UsbName::of_parts(
        &attribute("idVendor"),
        &attribute("idProduct"),
        &attribute("serial"),
    );
    let title = format!("{} {}", attribute("manufacturer"), attribute("product"));
    Some(UsbDevice {
        file: Path::new("/dev").join(file),
        name,
        title: title.trim().to_owned(),
    })
}

/// Returns the device file at present of a path that names a device; another path, and one that
/// exists, as it is.
///
/// # Errors
/// An error that names the devices that are plugged in, if none or several have the name.
pub fn usb_file(path: &str) -> io::Result<PathBuf> {
    file_among(path, &usb_devices())
}

fn file_among(path: &str, devices: &[UsbDevice]) -> io::Result<PathBuf> {
    let Some(wanted) = UsbName::of_alias(path).filter(|_| !Path::new(path).exists()) else {
        return Ok(path.into());
    };
    let with_name = |one: &&UsbDevice| one.name.as_ref() == Some(&wanted);
    let mut found = devices.iter().filter(with_name);
    match (found.next(), found.next()) {
        (Some(device), None) => Ok(device.file.clone()),
        (None, _) => {
            let known: Vec<String> = devices
                .iter()
                .filter_map(|one| one.name.as_ref())
                .map(ToString::to_string)
                .collect();
            let known = if known.is_empty() {
                "none".to_owned()
            } else {
                known.join(", ")
            };
            Err(io::Error::new(
                io::ErrorKind::NotFound,
                format!("no USBTMC device {wanted} is plugged in and switched on; found {known}"),
            ))
        }
        (Some(_), Some(_)) => Err(io::Error::new(
            io::ErrorKind::InvalidInput,
            format!("several USBTMC devices are {wanted}: name one by its file"),
        )),
    }
}

/// Checks that this process may open a device file, without opening it.
///
/// # Errors
/// The error of the operating system, with what helps.
pub fn may_open(path: &Path) -> io::Result<()> {
    nix::unistd::access(path, AccessFlags::R_OK | AccessFlags::W_OK)
        .map_err(|errno| explained(path, errno.into()))
}

/// Returns why a device file may not be opened, in words that help.
pub(super) fn explained(path: &Path, error: io::Error) -> io::Error {
    if error.kind() != io::ErrorKind::PermissionDenied {
        return error;
    }
    let Some(group) = fs::metadata(path).ok().map(|file| file.gid()) else {
        return error;
    };
    let groups = fs::read_to_string("/etc/group").unwrap_or_default();
    let help = match group_name(&groups, group).filter(|_| group != 0) {
        Some(name) => format!(
            "join the group of the file (`sudo usermod -aG {name} $USER`) and log in again"
        ),
        None => "it belongs to root: copy 60-eis-bench.rules into /etc/udev/rules.d and plug it in again"
            .to_owned(),
    };
    io::Error::new(error.kind(), format!("{error}; {help}"))
}

fn group_name(groups: &str, number: u32) -> Option<&str> {
    groups.lines().find_map(|line| {
        let mut fields = line.split(':');
        let name = fields.next()?;
        (fields.nth(1)?.parse() == Ok(number)).then_some(name)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plugged(file: &str, name: &str) -> UsbDevice {
        UsbDevice {
            file: file.into(),
            name: name.parse().ok(),
            title: String::new(),
        }
    }

    #[test]
    fn a_name_stands_for_one_device_wherever_it_is_plugged_in() {
        let name: UsbName = "F4EC:1017:SDS08A0X000001".parse().unwrap();
        assert_eq!(name.alias(), "/dev/usbtmc-f4ec-1017-SDS08A0X000001");
        assert_eq!(UsbName::of_alias(&name.alias()), Some(name.clone()));
        for wrong in [
            "f4ec:1017",
            "f4ec:1017:",
            "f4e:1017:A",
            "f4ec:1017:a/b",
            "+4ec:1017:A",
        ] {
            assert!(wrong.parse::<UsbName>().is_err(), "{wrong}");
        }
        let devices = [
            plugged("/dev/usbtmc0", "f4ec:1011:SDG"),
            plugged("/dev/usbtmc3", "f4ec:1017:SDS08A0X000001"),
        ];
        let file = file_among(&name.alias(), &devices).unwrap();
        assert_eq!(file, Path::new("/dev/usbtmc3"));
        assert_eq!(
            file_among("/dev/usbtmc7", &devices).unwrap(),
            Path::new("/dev/usbtmc7")
        );
        let missing = file_among("/dev/usbtmc-f4ec-1017-OTHER", &devices).unwrap_err();
        assert_eq!(
            missing.to_string(),
            "no USBTMC device f4ec:1017:OTHER is plugged in and switched on; found f4ec:1011:SDG, \
            f4ec:1017:SDS08A0X000001"
        );
        let twice = [devices[1].clone(), devices[1].clone()];
        let error = file_among(&name.alias(), &twice).unwrap_err().to_string();
        assert!(error.starts_with("several USBTMC devices"), "{error}");
    }

    #[test]
    fn devices_are_listed_as_the_kernel_has_them() {
        let folder = std::env::temp_dir().join(format!("eis-bench-usb-{}", std::process::id()));
        let (class, usb) = (folder.join("class"), folder.join("1-2"));
        fs::create_dir_all(usb.join("1-2:1.0")).unwrap();
        for (name, value) in [
            ("idVendor", "1ab1\n"),
            ("idProduct", "0514\n"),
            ("serial", "DHO8A1\n"),
            ("manufacturer", "RIGOL\n"),
            ("product", "DHO804\n"),
        ] {
            fs::write(usb.join(name), value).unwrap();
        }
        for file in ["usbtmc1", "hiddev0"] {
            fs::create_dir_all(class.join(file)).unwrap();
            std::os::unix::fs::symlink(usb.join("1-2:1.0"), class.join(file).join("device"))
                .unwrap();
        }
        let expected = UsbDevice {
            title: "RIGOL DHO804".to_owned(),
            ..plugged("/dev/usbtmc1", "1ab1:0514:DHO8A1")
        };
        assert_eq!(listed(&class), [expected]);
        assert!(listed(&folder.join("none")).is_empty());
        fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn a_file_that_may_not_be_opened_says_which_group_to_join() {
        let groups = "root:x:0:\ndialout:x:20:me\nplugdev:x:46:\n";
        assert_eq!(group_name(groups, 46), Some("plugdev"));
        assert_eq!(group_name(groups, 5), None);
        let file = std::env::current_exe().unwrap();
        let denied = io::Error::from(io::ErrorKind::PermissionDenied);
        let text = explained(&file, denied).to_string();
        assert!(
            text.starts_with("permission denied; ") && text.contains("again"),
            "{text}"
        );
        let other = explained(&file, io::ErrorKind::NotFound.into());
        assert_eq!(other.kind(), io::ErrorKind::NotFound);
    }
}
