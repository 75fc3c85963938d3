//! `eis-bench devices`: lists the instruments on USB and on serial ports of this machine by their addresses.

use std::path::{Path, PathBuf};

use clap::Args;
use instruments::transport::{UsbDevice, may_open, usb_devices};

use bench_core::safety::failure::Failure;
use bench_plan::support::terminal::say;

/// Names of serial ports that stay when the cable is plugged in elsewhere.
const SERIAL: &str = "/dev/serial/by-id";

/// Arguments of `devices`.
#[derive(Debug, Args)]
pub struct DevicesArgs {}

/// Lists the devices; opens none, and sends nothing.
///
/// # Errors
/// None.
pub fn devices(_: &DevicesArgs) -> Result<(), Failure> {
    for line in lines(&usb_devices(), &serial_ports(Path::new(SERIAL))) {
        say!("{line}");
    }
    Ok(())
}

fn serial_ports(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut ports: Vec<_> = entries.map(|entry| entry.path()).collect();
    ports.sort();
    ports
}

fn lines(usb: &[UsbDevice], serial: &[PathBuf]) -> Vec<String> {
    let permission = |file: &Path| match may_open(file) {
        Ok(()) => String::new(),
        Err(error) => format!(": {error}"),
    };
    let mut lines = Vec::new();
    for device in usb {
        let file = device.file.display();
        let address = match &device.name {
            Some(name) => format!("usb:{name}  {file}"),
            None => format!("usbtmc:{file}  without a serial number"),
        };
        let title = &device.title;
        lines.push(format!("{address}  {title}{}", permission(&device.file)));
    }
    for port in serial {
        lines.push(format!("serial:{}{}", port.display(), permission(port)));
    }
    if lines.is_empty() {
        lines.push(
            "no USBTMC device and no serial port of a USB adapter; is the instrument on, and set to \
            USBTMC?"
                .to_owned(),
        );
    }
    lines.push(
        "instruments on the network are not searched; who answers: eis-bench identify ADDRESS"
            .to_owned(),
    );
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn devices_are_printed_by_the_address_that_stays() {
        let usb = [
            UsbDevice {
                file: "/dev/no-usbtmc0".into(),
                name: "f4ec:1017:SDS08A0X000001".parse().ok(),
                title: "Siglent SDS824X HD".to_owned(),
            },
            UsbDevice {
                file: "/dev/null".into(),
                name: None,
                title: "ACME".to_owned(),
            },
        ];
        let found = lines(&usb, &["/dev/null".into()]);
        assert_eq!(
            found[..3],
            [
                "usb:f4ec:1017:SDS08A0X000001  /dev/no-usbtmc0  Siglent SDS824X HD: No such file or \
                directory (os error 2)",
                "usbtmc:/dev/null  without a serial number  ACME",
                "serial:/dev/null",
            ]
        );
        assert!(lines(&[], &[])[0].starts_with("no USBTMC device"));
        assert!(serial_ports(Path::new("/no/folder")).is_empty());
    }
}
