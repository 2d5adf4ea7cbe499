//! The lines of the robot: joints and position.

use bcap_terminal::screen::Line;

const NAMES: [&str; 6] = ["X", "Y", "Z", "RX", "RY", "RZ"];

/// Formats the joints and the position of the tool centre point, three numbers a line.
pub(crate) fn robot_lines(joints: &[f64], position: &[f64]) -> Vec<Line> {
    // the extended axes of an arm without them are 0
    let used = if joints.iter().skip(6).all(|joint| *joint == 0.0) { joints.len().min(6) } else { joints.len() };
    let joints: Vec<String> =
        joints.iter().take(used).enumerate().map(|(n, j)| number(&format!("J{}", n + 1), *j)).collect();
    let position: Vec<String> = NAMES.iter().zip(position).map(|(name, value)| number(name, *value)).collect();
    joints.chunks(3).chain(position.chunks(3)).map(|row| Line::new(row.join(" "))).collect()
}

fn number(name: &str, value: f64) -> String {
    // + 0.0 makes a negative zero positive
    let rounded = (value * 1000.0).round() / 1000.0 + 0.0;
    format!("{name:<2} {rounded:>9.3}")
}

/// Formats the numbers of a title or line that are known: `FIG 5  tool 1`.
pub(crate) fn numbered(parts: &[(&str, Option<String>)]) -> String {
    let known = parts.iter().filter_map(|(name, value)| Some(format!("{name} {}", value.as_ref()?)));
    known.collect::<Vec<_>>().join("  ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn joints_and_position_are_three_a_line() {
        let joints = [0.0, 45.0, -90.0, -0.000_01, 12.345_67, 170.0, 0.0, 0.0];
        let text = |joints: &[f64]| -> Vec<String> {
            robot_lines(joints, &[364.16, 0.0, 278.535, 180.0, 0.0, -180.0, 5.0])
                .into_iter()
                .map(|line| line.text)
                .collect()
        };
        let position = ["X    364.160 Y      0.000 Z    278.535", "RX   180.000 RY     0.000 RZ  -180.000"];
        let six = ["J1     0.000 J2    45.000 J3   -90.000", "J4     0.000 J5    12.346 J6   170.000"];
        assert_eq!(text(&joints), [six, position].concat());
        let eight = [&joints[..7], &[1.0]].concat();
        assert_eq!(text(&eight)[2], "J7     0.000 J8     1.000");
        assert_eq!(text(&[]), position);
    }
}
