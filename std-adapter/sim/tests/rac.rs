//! The communication samples of the RAC specification, section 4, on each model.

use bcap_core::hresult::HResult;
use bcap_sim::{Config, Profile};

use crate::common::{World, code, value};

#[test]
fn each_sample_of_the_specification_reads_what_the_other_has_written() {
    let samples = [
        ("I", "3, 123", value(&123)),
        ("F", "4, 123.01", value(&123.01_f32)),
        ("D", "5, 123.01", value(&123.01_f64)),
        ("S", "8, Test", value("Test")),
        ("V", " 8196, 1, 2, 3", value(&[1.0_f32, 2.0, 3.0])),
        ("P", "8196, 1, 2, 3, 4, 5, 6, -1", value(&[1.0_f32, 2.0, 3.0, 4.0, 5.0, 6.0, -1.0])),
        ("J", "8196, 1, 2, 3, 4, 5, 6, 7, 8", value(&[1.0_f32, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0])),
        ("T", "8196, 1, 2, 3, 4, 5, 6, 7, 8, 9, -1", {
            value(&[1.0_f32, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, -1.0])
        }),
        // the text has "10" in place of "IO"
        ("IO", "11, 0", value(&false)),
    ];
    for profile in Profile::ALL {
        let mut world = World::with(Config::new(profile));
        for (kind, text, written) in &samples {
            assert_eq!(world.rac(&format!("PUT:RC8:10:{kind}:{text}")), code(HResult::S_OK), "{profile:?} {kind}");
            let read = world.rac(&format!("GET:RC8:10:{kind}:"));
            assert_eq!(read, (HResult::S_OK, written.clone()), "{profile:?} {kind}");
        }
    }
}
