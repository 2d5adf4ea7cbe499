//! Tests of RAC lines: all samples of the specification, and properties of requests, responses and the framing.

use bcap_core::error::TextErrorKind;
use bcap_core::hresult::HResult;
use bcap_core::rac::{MAX_LINE, MAX_VALUE, Request, Response, Variable, VariableKind};
use bcap_core::variant::{VariantBuf, Writer};
use bcap_testkit::strategies;
use bcap_testkit::value::Value;
use bcap_testkit::vectors::texts;
use proptest::prelude::*;

fn request_line(request: &Request<'_>) -> Option<String> {
    let mut buffer = [0xa5; 300];
    let mut out = Writer::new(&mut buffer);
    request.write_line(&mut out).ok()?;
    Some(String::from_utf8(out.as_bytes().to_vec()).unwrap())
}

fn response_line(response: &Response<'_>) -> Option<String> {
    let mut buffer = [0xa5; 300];
    let mut out = Writer::new(&mut buffer);
    response.write_line(&mut out).ok()?;
    Some(String::from_utf8(out.as_bytes().to_vec()).unwrap())
}

/// The variable's kind and value of each command, from the column "meaning" of the vectors' file.
fn meanings() -> Vec<(VariableKind, Value)> {
    let single = |n: f32| Value::R4(n.to_bits());
    let array = |numbers: &[f32]| Value::Array(4, numbers.iter().map(|n| single(*n)).collect());
    vec![
        (VariableKind::I, Value::I4(123)),
        (VariableKind::F, single(123.01)),
        (VariableKind::D, Value::R8(123.01_f64.to_bits())),
        (VariableKind::S, Value::text("Test")),
        (VariableKind::V, array(&[1.0, 2.0, 3.0])),
        (VariableKind::P, array(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, -1.0])),
        (VariableKind::J, array(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0])),
        (VariableKind::T, array(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, -1.0])),
        (VariableKind::Io, Value::Bool(false)),
    ]
}

#[test]
fn the_samples_of_the_specification_mean_what_it_says() {
    let texts = texts();
    let line = |name: &str| texts.iter().find(|vector| vector.name == name).unwrap().text.strip_suffix('\r').unwrap();
    for (number, (kind, value)) in (1..).zip(meanings()) {
        let variable = Variable::new(kind, 10);
        let mut memory = [0; MAX_VALUE];
        let get = Request::parse(line(&format!("rac_cmd_{number:02}_req")).as_bytes(), &mut memory).unwrap();
        assert_eq!(get, Request::Get(variable));
        let sample = line(&format!("rac_cmd_{number:02}_resp"));
        let reply = Response::parse(sample.as_bytes(), &mut memory).unwrap();
        assert_eq!((reply.result, reply.value.map(Value::read)), (HResult::S_OK, Some(value.clone())), "{sample}");
        // written lines have no blanks, and the strings in these samples contain none
        assert_eq!(response_line(&reply).unwrap(), format!("{}\r", sample.replace(' ', "")));
        let sample = line(&format!("rac_cmd_{:02}_req", number + 9));
        let put = Request::parse(sample.as_bytes(), &mut memory).unwrap();
        assert_eq!((put.variable(), put.value().map(Value::read)), (variable, Some(value)), "{sample}");
        assert!(put.value().is_some_and(|value| kind.fits(&value)), "{sample}");
        assert_eq!(request_line(&put).unwrap(), format!("{}\r", sample.replace(' ', "")));
        let done = Response::parse(line(&format!("rac_cmd_{:02}_resp", number + 9)).as_bytes(), &mut memory).unwrap();
        assert_eq!(done, Response { result: HResult::S_OK, value: None });
    }
}

#[test]
fn the_damaged_sample_names_the_part() {
    let error = Request::parse(b"PUT:RC8:10:10:11, 0", &mut [0; 64]).unwrap_err();
    assert_eq!((error.kind, error.column), (TextErrorKind::VariableType, 12));
    let error = Request::parse(b"PUT:RC8:10:10:", &mut [0; 64]).unwrap_err();
    assert_eq!((error.kind, error.column), (TextErrorKind::VariableType, 12));
}

fn variable() -> impl Strategy<Value = Variable> {
    let kinds = meanings().into_iter().map(|(kind, _)| kind).collect::<Vec<_>>();
    (prop::sample::select(kinds), any::<u32>()).prop_map(|(kind, index)| Variable::new(kind, index))
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 1000, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn a_request_that_is_written_reads_back_the_same(variable in variable(), value in strategies::value()) {
        let owned = VariantBuf::<2048>::new(&value).unwrap();
        for request in [Request::Get(variable), Request::Put(variable, owned.as_variant())] {
            let Some(line) = request_line(&request) else { continue };
            prop_assert!(line.len() <= MAX_LINE && line.ends_with('\r') && line.matches(['\r', '\n']).count() == 1);
            let mut memory = [0; MAX_VALUE];
            prop_assert_eq!(Request::parse(&line.as_bytes()[..line.len() - 1], &mut memory), Ok(request));
        }
    }

    #[test]
    fn a_response_that_is_written_reads_back_the_same(code in any::<i32>(), value in strategies::value(), with in any::<bool>()) {
        let owned = VariantBuf::<2048>::new(&value).unwrap();
        let response = Response { result: HResult(code), value: with.then(|| owned.as_variant()) };
        let Some(line) = response_line(&response) else { return Ok(()) };
        prop_assert!(line.len() <= MAX_LINE && line.ends_with('\r') && line.matches(['\r', '\n']).count() == 1);
        let mut memory = [0; MAX_VALUE];
        prop_assert_eq!(Response::parse(&line.as_bytes()[..line.len() - 1], &mut memory), Ok(response));
    }

    #[test]
    fn damaged_lines_are_taken_as_the_oracle_takes_them(
        index in 0_usize..36, damage in prop::collection::vec(strategies::damage(), 1..4), cuts in any::<[u8; 4]>()
    ) {
        let samples: Vec<_> = texts().into_iter().filter(|vector| vector.text.ends_with('\r')).collect();
        let mut line = samples[index].text.trim_end().as_bytes().to_vec();
        damage.into_iter().for_each(|damage| damage.apply(&mut line));
        bcap_fuzz::rac_line(&[&cuts[..], &line, b"\r"].concat());
    }

    #[test]
    fn lines_are_the_same_however_the_bytes_are_cut(
        lines in prop::collection::vec("[ -~]{0,40}|[ -~]{250,600}", 0..8), cuts in any::<[u8; 4]>()
    ) {
        let stream = lines.iter().flat_map(|line| [line.as_bytes(), b"\r"].concat());
        bcap_fuzz::rac_line(&cuts.into_iter().chain(stream).collect::<Vec<_>>());
    }
}
