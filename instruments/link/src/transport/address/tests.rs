use proptest::prelude::*;

use super::{
    serial::{DataBits, Flow, Parity, StopBits},
    *,
};

fn at(host: &str, port: u16) -> Socket {
    Socket {
        host: host.to_owned(),
        port,
    }
}

fn vxi11(host: &str, port: Vxi11Port) -> Address {
    Address::Vxi11 {
        host: host.to_owned(),
        port,
        device: "inst0".to_owned(),
    }
}

fn tcp(host: &str, port: u16) -> Address {
    Address::Tcp(at(host, port))
}

#[test]
fn addresses_are_read() {
    let julabo = SerialSettings {
        path: "/dev/ttyUSB0".to_owned(),
        baud: 4800,
        parity: Parity::Even,
        data_bits: DataBits::Seven,
        stop_bits: StopBits::One,
        flow: Flow::RtsCts,
    };
    let table = [
        ("tcp://192.0.2.20:5025", tcp("192.0.2.20", 5025)),
        ("tcp://scope.lab:5555", tcp("scope.lab", 5555)),
        ("tcp://[::1]:5025", tcp("[::1]", 5025)),
        (
            "serial:/dev/ttyUSB0?baud=4800&parity=even&data=7&stop=1&flow=rtscts",
            Address::Serial(julabo.clone()),
        ),
        (
            "serial:/dev/ttyUSB0?flow=rtscts&data=7&parity=even&baud=4800",
            Address::Serial(julabo),
        ),
        (
            "serial:/dev/ttyS0",
            Address::Serial(SerialSettings::new("/dev/ttyS0")),
        ),
        (
            "memory:scope-1",
            Address::Memory {
                name: "scope-1".to_owned(),
            },
        ),
        (
            "vxi11:10.0.0.5/inst0",
            vxi11("10.0.0.5", Vxi11Port::Mapped(111)),
        ),
        ("vxi11:10.0.0.5", vxi11("10.0.0.5", Vxi11Port::Mapped(111))),
        (
            "vxi11:localhost/inst0?portmapper=1111",
            vxi11("localhost", Vxi11Port::Mapped(1111)),
        ),
        (
            "vxi11:[::1]:1024/inst0",
            vxi11("[::1]", Vxi11Port::Fixed(1024)),
        ),
        (
            "hislip:scope.lab",
            Address::HiSlip {
                socket: at("scope.lab", 4880),
                device: "hislip0".to_owned(),
            },
        ),
        (
            "hislip:[::1]/hislip1",
            Address::HiSlip {
                socket: at("[::1]", 4880),
                device: "hislip1".to_owned(),
            },
        ),
        (
            "hislip:10.0.0.5:5000/hislip0",
            Address::HiSlip {
                socket: at("10.0.0.5", 5000),
                device: "hislip0".to_owned(),
            },
        ),
        (
            "usbtmc:/dev/usbtmc0",
            Address::UsbTmc {
                path: "/dev/usbtmc0".to_owned(),
            },
        ),
        (
            "usb:F4EC:1017:SDS08A0X000001",
            Address::UsbTmc {
                path: "/dev/usbtmc-f4ec-1017-SDS08A0X000001".to_owned(),
            },
        ),
        (
            "gpib:tcp:10.0.0.9:1234/7",
            Address::Gpib {
                adapter: Adapter::Tcp(at("10.0.0.9", 1234)),
                address: 7,
            },
        ),
        (
            "gpib:serial:/dev/ttyUSB0/30?baud=115200",
            Address::Gpib {
                adapter: Adapter::Serial(SerialSettings {
                    baud: 115_200,
                    ..SerialSettings::new("/dev/ttyUSB0")
                }),
                address: 30,
            },
        ),
    ];
    for (text, address) in table {
        assert_eq!(text.parse(), Ok(address), "{text}");
    }
}

#[test]
fn mistakes_are_named_by_field() {
    let table = [
        (
            "tcp://:5025",
            "host: expected a host name, an IPv4 address or an IPv6 address in brackets, found ``",
        ),
        (
            "tcp://a b:5025",
            "host: expected a host name, an IPv4 address or an IPv6 address in brackets, found `a \
            b`",
        ),
        (
            "tcp://::1:5025",
            "host: expected a host name, an IPv4 address or an IPv6 address in brackets, found \
            `::1`",
        ),
        (
            "tcp://host",
            "port: expected a number from 1 to 65535 after the host, found ``",
        ),
        (
            "tcp://[::1]",
            "port: expected a number from 1 to 65535 after the host, found ``",
        ),
        (
            "tcp://host:0",
            "port: expected a number from 1 to 65535 after the host, found `0`",
        ),
        (
            "tcp://host:65536",
            "port: expected a number from 1 to 65535 after the host, found `65536`",
        ),
        (
            "tcp://host:+25",
            "port: expected a number from 1 to 65535 after the host, found `+25`",
        ),
        (
            "serial:COM1",
            "path: expected the absolute path of a device such as /dev/ttyUSB0, found `COM1`",
        ),
        (
            "serial:/dev/ttyS0?parity=mark",
            "parity: expected none, even, odd, found `mark`",
        ),
        ("serial:/dev/ttyS0?data=9", "data: expected 7, 8, found `9`"),
        ("serial:/dev/ttyS0?stop=", "stop: expected 1, 2, found ``"),
        (
            "serial:/dev/ttyS0?flow=hard",
            "flow: expected none, rtscts, xonxoff, found `hard`",
        ),
        (
            "serial:/dev/ttyS0?bauds=9600",
            "option: expected baud, parity, data, stop or flow, found `bauds=9600`",
        ),
        (
            "serial:/dev/ttyS0?data=7&data=8",
            "option: expected every option once, found `data=8`",
        ),
        (
            "vxi11:/inst0",
            "host: expected a host name, an IPv4 address or an IPv6 address in brackets, found ``",
        ),
        (
            "vxi11:host:0/inst0",
            "port: expected a number from 1 to 65535 after the host, found `0`",
        ),
        (
            "vxi11:host/",
            "device: expected a name such as inst0 or hislip0, found ``",
        ),
        (
            "vxi11:host/inst0?port=5",
            "option: expected portmapper=PORT, found `port=5`",
        ),
        (
            "vxi11:host:99/inst0?portmapper=5",
            "option: expected a port or a port mapper, not both, found `portmapper=5`",
        ),
        (
            "hislip:host:x",
            "port: expected a number from 1 to 65535 after the host, found `x`",
        ),
        (
            "hislip:host/a b",
            "device: expected a name such as inst0 or hislip0, found `a b`",
        ),
        (
            "usbtmc:0",
            "path: expected the absolute path of a device such as /dev/usbtmc0, found `0`",
        ),
        (
            "gpib:tcp:host:1234",
            "gpib address: expected a number from 0 to 30 behind the adapter and a `/`, found ``",
        ),
        (
            "gpib:tcp:host:1234/31",
            "gpib address: expected a number from 0 to 30 behind the adapter and a `/`, found `31`",
        ),
        (
            "gpib:tcp:host/7",
            "port: expected a number from 1 to 65535 after the host, found ``",
        ),
        (
            "gpib:serial:/dev/ttyUSB0/x",
            "gpib address: expected a number from 0 to 30 behind the adapter and a `/`, found `x`",
        ),
        (
            "gpib:serial:/dev/ttyUSB0/3?baud",
            "baud: expected 300, 600, 1200, 2400, 4800, 9600, 19200, 38400, 57600, 115200, 230400, \
            460800, found ``",
        ),
        (
            "memory:",
            "name: expected letters, digits, `.`, `_` and `-`, found ``",
        ),
        (
            "memory:a/b",
            "name: expected letters, digits, `.`, `_` and `-`, found `a/b`",
        ),
    ];
    for (text, message) in table {
        assert_eq!(
            text.parse::<Address>().unwrap_err().to_string(),
            message,
            "{text}"
        );
    }
    for text in [
        "192.0.2.20:5025",
        "tcp:host:5025",
        "gpib:usb:1/2",
        "gpib",
        "telnet:host:23",
    ] {
        let message = text.parse::<Address>().unwrap_err().to_string();
        assert!(
            message.starts_with("address: expected tcp://HOST:PORT, serial:/dev/PORT")
                && message.ends_with(&format!("found `{text}`")),
            "{message}"
        );
    }
    let baud = "serial:/dev/ttyS0?baud=9601"
        .parse::<Address>()
        .unwrap_err();
    assert!(
        baud.to_string().starts_with("baud: expected 300, 600,")
            && baud.to_string().ends_with("found `9601`"),
        "{baud}"
    );
    assert_eq!(baud.field(), "baud");
}

fn any_address() -> impl Strategy<Value = Address> {
    let words = (0_usize..3, 0_usize..2, 0_usize..2, 0_usize..3);
    let socket = |(host, port)| Socket { host, port };
    let named = ("[a-z0-9.-]{1,20}", 1_u16..).prop_map(socket);
    let numbered = (any::<u128>(), 1_u16..).prop_map(move |(bits, port)| {
        socket((format!("[{}]", std::net::Ipv6Addr::from_bits(bits)), port))
    });
    let socket = prop_oneof![named, numbered].boxed();
    let serial = (
        "/dev/[a-zA-Z0-9/=&._-]{1,20}",
        prop::sample::select(vec![300, 4800, 115_200]),
        words,
    )
        .prop_map(|(path, baud, (parity, data, stop, flow))| SerialSettings {
            path,
            baud,
            parity: Parity::WORDS[parity].1,
            data_bits: DataBits::WORDS[data].1,
            stop_bits: StopBits::WORDS[stop].1,
            flow: Flow::WORDS[flow].1,
        });
    let serial = serial.boxed();
    let adapter = prop_oneof![
        socket.clone().prop_map(Adapter::Tcp),
        serial.clone().prop_map(Adapter::Serial)
    ];
    let device = "[a-z]{1,6}[0-9]{0,2}";
    prop_oneof![
        socket.clone().prop_map(Address::Tcp),
        serial.prop_map(Address::Serial),
        (socket.clone(), any::<bool>(), device).prop_map(
            |(Socket { host, port }, fixed, device)| {
                let port = if fixed {
                    Vxi11Port::Fixed(port)
                } else {
                    Vxi11Port::Mapped(port)
                };
                Address::Vxi11 { host, port, device }
            }
        ),
        (socket, device).prop_map(|(socket, device)| Address::HiSlip { socket, device }),
        "/dev/[a-z0-9/]{1,20}".prop_map(|path| Address::UsbTmc { path }),
        (adapter, 0_u8..=30).prop_map(|(adapter, address)| Address::Gpib { adapter, address }),
        "[A-Za-z0-9._-]{1,20}".prop_map(|name| Address::Memory { name }),
    ]
}

proptest! {
    #[test]
    fn what_is_written_is_read_back(address in any_address()) {
        prop_assert_eq!(address.to_string().parse(), Ok(address));
    }

    #[test]
    fn no_text_makes_the_reader_panic(
        text in "(tcp://|serial:/|memory:|vxi11:|hislip:|usbtmc:/|gpib:tcp:|gpib:serial:/)?[ -~]{0,30}",
    ) {
        if let Ok(address) = text.parse::<Address>() {
            prop_assert_eq!(address.to_string().parse(), Ok(address));
        }
    }
}
