//! Which of the cameras present is the one that was unplugged. Pure.

/// What tells one camera from another.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Identity {
    /// What the camera calls itself.
    pub card: String,
    /// Where it is plugged in.
    pub bus: String,
    /// USB serial number, where it has one.
    pub serial: Option<String>,
}

/// The position in `present` of the camera that left: by serial number wherever it is plugged in;
/// without one, the same model in the same port; or the only one of the model.
///
/// The node's number is not looked at: it may change. All cameras in `present` offer depth.
#[must_use]
pub fn find_again(left: &Identity, present: &[Identity]) -> Option<usize> {
    let same_model = |p: &&Identity| p.card == left.card;
    if left.serial.is_some() {
        return present
            .iter()
            .position(|p| p.card == left.card && p.serial == left.serial);
    }
    let same_port = present
        .iter()
        .position(|p| same_model(&p) && p.bus == left.bus);
    same_port.or_else(|| {
        let position = present.iter().position(|p| same_model(&p))?;
        (present.iter().filter(same_model).count() == 1).then_some(position)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(card: &str, bus: &str, serial: Option<&str>) -> Identity {
        Identity {
            card: card.into(),
            bus: bus.into(),
            serial: serial.map(String::from),
        }
    }

    #[test]
    fn a_serial_number_is_followed_to_another_port() {
        let left = camera("D435", "usb-1", Some("42"));
        let others = [
            camera("D435", "usb-1", Some("7")),
            camera("D435", "usb-2", Some("42")),
        ];
        assert_eq!(find_again(&left, &others), Some(1));
        assert_eq!(
            find_again(&left, &others[..1]),
            None,
            "another camera in its port"
        );
    }

    #[test]
    fn without_a_serial_number_port_then_model_decide() {
        let left = camera("D435", "usb-1", None);
        let twins = [camera("D435", "usb-2", None), camera("D435", "usb-1", None)];
        assert_eq!(find_again(&left, &twins), Some(1));
        assert_eq!(
            find_again(&left, &twins[..1]),
            Some(0),
            "the only one of its model"
        );
        let strangers = [camera("D435", "usb-2", None), camera("D435", "usb-3", None)];
        assert_eq!(find_again(&left, &strangers), None, "either could be it");
        assert_eq!(find_again(&left, &[camera("Webcam", "usb-1", None)]), None);
        assert_eq!(find_again(&left, &[]), None);
    }
}
