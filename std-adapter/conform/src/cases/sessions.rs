//! Sessions: Service_Start to Service_Stop.

use bcap_core::bcap::FunctionId as F;
use bcap_core::hresult::HResult;

use crate::bench::{Bench, Stop, skip};
use crate::case::Arg::{H, S};
use crate::case::Setup::{Connected, Controller, Started};
use crate::case::{Body, Case, Group, Setup, Slot, Step, Want, case, steps};
use bcap_testkit::wire::Link;

const C: Slot = Slot::Controller;
const A: Slot = Slot::A;

const fn session(
    name: &'static str,
    source: &'static str,
    rule: &'static str,
    setup: Setup,
    table: &'static [Step],
) -> Case {
    case(Group::Sessions, name, source, rule, setup, steps(table))
}

/// The specification shows the options only; their rules come from the vendor's client library.
const OPTIONS: &str = "b-CAP specification, Table 4-1, the vendor's client library";

/// Service_Start with an option must succeed.
macro_rules! accepted {
    ($name:literal, $option:literal, $rule:literal) => {
        session($name, OPTIONS, $rule, Connected, &[Step::Must(F::SERVICE_START, &[S($option)], Want::NoValue)])
    };
}

macro_rules! refused {
    ($name:literal, $option:literal, $rule:literal) => {
        session(
            $name,
            OPTIONS,
            $rule,
            Connected,
            &[
                Step::Must(F::SERVICE_START, &[S($option)], Want::Code(&[HResult::E_INVALIDARG])),
                Step::Must(F::SERVICE_START, &[S("")], Want::NoValue),
            ],
        )
    };
}

pub(super) const CASES: &[Case] = &[
    session(
        "start-and-stop",
        "b-CAP specification, section 4.1.5",
        "Service_Stop ends the session",
        Connected,
        &[Step::Must(F::SERVICE_START, &[], Want::NoValue), Step::Must(F::SERVICE_STOP, &[], Want::NoValue)],
    ),
    session(
        "start-again",
        "b-CAP specification, section 4.1.1",
        "after Service_Stop the connection may start another session",
        Connected,
        &[
            Step::Must(F::SERVICE_START, &[], Want::NoValue),
            Step::Must(F::SERVICE_STOP, &[], Want::NoValue),
            Step::Must(F::SERVICE_START, &[], Want::NoValue),
        ],
    ),
    session(
        "connect-and-disconnect",
        "b-CAP specification, section 4.1.2",
        "Controller_Connect returns a handle, which Controller_Disconnect releases",
        Controller,
        &[Step::Must(F::CONTROLLER_DISCONNECT, &[H(C)], Want::NoValue)],
    ),
    session(
        "connect-twice",
        "b-CAP specification, section 4.1.2",
        "a controller may be connected again after its release",
        Controller,
        &[
            Step::Must(F::CONTROLLER_DISCONNECT, &[H(C)], Want::NoValue),
            Step::ConnectController,
            Step::Call(F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")], Want::Ok),
        ],
    ),
    case(
        Group::Sessions,
        "two-controllers",
        "b-CAP specification, section 4.1.2",
        "one client may connect to the controller twice",
        Controller,
        Body::Run(two_controllers),
    ),
    case(
        Group::Sessions,
        "connect-before-start",
        "b-CAP specification, section 4.1",
        "Service_Start comes first",
        Connected,
        Body::Run(connect_before_start),
    ),
    session(
        "handle-before-start",
        "b-CAP specification, section 4.1",
        "Service_Start comes first",
        Connected,
        &[Step::Must(F::CONTROLLER_GET_NAME, &[crate::case::Arg::I(1)], Want::Refused)],
    ),
    session(
        "stop-releases-handles",
        "b-CAP specification, section 4.1.5",
        "after Service_Stop all handles are invalid",
        Controller,
        &[
            Step::Open(A, F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")]),
            Step::Must(F::SERVICE_STOP, &[], Want::NoValue),
            Step::Must(F::SERVICE_START, &[S("")], Want::NoValue),
            Step::Must(F::VARIABLE_GET_VALUE, &[H(A)], Want::Code(&[HResult::E_HANDLE])),
        ],
    ),
    session(
        "work-after-stop",
        "b-CAP specification, section 4.1.5",
        "after Service_Stop nothing but Service_Start is served",
        Controller,
        &[Step::Must(F::SERVICE_STOP, &[], Want::NoValue), Step::Must(F::CONTROLLER_GET_NAME, &[H(C)], Want::Refused)],
    ),
    session(
        "end-releases-handles",
        "b-CAP specification, section 4.1.4",
        "handles do not outlive their connection",
        Controller,
        &[
            Step::Open(A, F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")]),
            Step::Reconnect,
            Step::Must(F::VARIABLE_GET_VALUE, &[H(A)], Want::Code(&[HResult::E_HANDLE])),
        ],
    ),
    session(
        "refused-call-keeps-the-session",
        "RAC specification, Table 2-2",
        "an error of a call does not end the session",
        Controller,
        &[
            Step::Must(F::CONTROLLER_GET_VARIABLE, &[H(C), S("NoSuchVariable"), S("")], Want::Refused),
            Step::Open(A, F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")]),
            Step::Must(F::VARIABLE_GET_VALUE, &[H(A)], Want::Type(3)),
        ],
    ),
    case(
        Group::Sessions,
        "unknown-provider",
        "b-CAP specification, section 4.1.2",
        "a provider that does not exist is refused",
        Started,
        Body::Run(unknown_provider),
    ),
    accepted!("option-empty", "", "the option may be empty"),
    accepted!("option-wdt-81", "WDT=81", "an interval above 80 ms is accepted"),
    accepted!("option-wdt-400", "WDT=400", "the option of the specification's frame"),
    accepted!("option-lower-case", "wdt=400", "the case of a key does not matter"),
    accepted!("option-blanks", " WDT = 400 ", "blanks around key and value do not matter"),
    accepted!("option-leading-comma", ",WDT=400", "a leading comma does not matter"),
    accepted!("option-invoke-timeout", ",WDT=400,InvokeTimeout=180000", "open drivers send this option"),
    // no text says which: the vendor's server library ignores them, `bcap sim` refuses them
    session(
        "option-unknown-key",
        OPTIONS,
        "an unknown key is ignored or refused",
        Connected,
        &[Step::Must(
            F::SERVICE_START,
            &[S("Colour=blue,WDT=400")],
            Want::Code(&[HResult::S_OK, HResult::E_INVALIDARG]),
        )],
    ),
    accepted!("option-brackets", "WDT=(400)", "a value may be in brackets"),
    refused!("option-wdt-79", "WDT=79", "an interval below 80 ms is refused"),
    refused!("option-wdt-0", "WDT=0", "an interval below 80 ms is refused"),
    refused!("option-wdt-1", "WDT=1", "an interval below 80 ms is refused"),
    refused!("option-invoke-timeout-79", "InvokeTimeout=79", "a time limit below 80 ms is refused"),
    case(
        Group::Sessions,
        "two-clients",
        "RAC specification, section 3.1",
        "two clients work at the same time",
        Controller,
        Body::Run(two_clients),
    ),
    case(
        Group::Sessions,
        "ten-clients",
        "RAC specification, section 3.1",
        "ten clients work at the same time",
        Started,
        Body::Run(ten_clients),
    )
    .over(Link::Tcp),
    case(
        Group::Sessions,
        "one-after-another",
        "b-CAP specification, section 4.1",
        "fifty clients may come one after the other",
        Started,
        Body::Run(one_after_another),
    )
    .over(Link::Tcp),
];

/// Controllers refuse the call; the specification only shows the order, and servers of small devices do not need it.
fn connect_before_start(bench: &mut Bench<'_>) -> Result<(), Stop> {
    let arguments = [S(""), S("CaoProv.DENSO.VRC"), S("localhost"), S("")];
    let reply = bench.call(F::CONTROLLER_CONNECT, &arguments)?;
    if reply.code.is_ok() { skip("the device needs no Service_Start") } else { Ok(()) }
}

/// The server of a device that is no controller may have any provider.
fn unknown_provider(bench: &mut Bench<'_>) -> Result<(), Stop> {
    let arguments = [S(""), S("CaoProv.NoSuch.Provider"), S("localhost"), S("")];
    let reply = bench.call(F::CONTROLLER_CONNECT, &arguments)?;
    if reply.code.is_ok() { skip("the device accepts any provider") } else { Ok(()) }
}

fn two_controllers(bench: &mut Bench<'_>) -> Result<(), Stop> {
    let first = bench.handle(C);
    bench.open_controller()?;
    let second = bench.handle(C);
    bench.want(F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")], Want::Type(3))?;
    if first != second {
        bench.must(F::CONTROLLER_DISCONNECT, &[H(C)], Want::NoValue)?;
        bench.set_handle(C, first);
    }
    bench.want(F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")], Want::Type(3)).map(drop)
}

fn two_clients(bench: &mut Bench<'_>) -> Result<(), Stop> {
    let mut other = bench.another()?;
    other.open_controller()?;
    for _ in 0..3 {
        bench.want(F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")], Want::Type(3))?;
        other.want(F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")], Want::Type(3))?;
    }
    other.must(F::SERVICE_STOP, &[], Want::NoValue)?;
    // the end of one session leaves the other one alone
    bench.want(F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")], Want::Type(3)).map(drop)
}

fn ten_clients(bench: &mut Bench<'_>) -> Result<(), Stop> {
    let mut others = (0..9).map(|_| bench.another()).collect::<Result<Vec<_>, _>>()?;
    others.iter_mut().try_for_each(|other| other.must(F::SERVICE_STOP, &[], Want::NoValue).map(drop))
}

fn one_after_another(bench: &mut Bench<'_>) -> Result<(), Stop> {
    bench.close();
    (0..50).try_for_each(|_| {
        // not `another`, which skips the case if the device has lost its slots
        let mut client = Bench::new(bench.options, bench.link);
        client.connect()?;
        client.must(F::SERVICE_START, &[S("")], Want::NoValue).map(drop)
    })
}
