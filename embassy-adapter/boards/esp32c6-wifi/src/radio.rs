//! The connection to the Wi-Fi network of the settings.

use bcap_board::Settings;
use embassy_time::Timer;
use esp_hal::efuse::{MacAddress, override_mac_address};
use esp_hal::peripherals::WIFI;
use esp_radio::wifi::sta::StationConfig;
use esp_radio::wifi::{AuthenticationMethodConfig, Config, ControllerConfig, WifiController};

/// The pause before another attempt to connect to the access point, in seconds.
const PAUSE: u64 = 2;

/// Starts the radio, with the MAC address of the settings; otherwise it has the one of the chip.
pub(crate) fn start(wifi: WIFI<'static>, settings: &Settings<'_>) -> Option<WifiController<'static>> {
    if let Some(mac) = settings.mac {
        // only a second call fails
        let _ = override_mac_address(MacAddress::new_eui48(mac));
    }
    WifiController::new(wifi, ControllerConfig::default()).ok()
}

/// Connects to the access point, again and again.
#[embassy_executor::task]
pub(crate) async fn connect(mut radio: WifiController<'static>, settings: &'static Settings<'static>) {
    let config = station(settings).map(Config::Station);
    if !config.is_some_and(|config| radio.set_config(&config).is_ok()) {
        defmt::error!("no setting ssid, or the radio refuses it: the board has no network");
        return;
    }
    loop {
        match radio.connect_async().await {
            Ok(_) => {
                let _ = radio.wait_for_disconnect_async().await;
                defmt::warn!("Wi-Fi: disconnected");
            }
            Err(_) => defmt::warn!("Wi-Fi: cannot connect"),
        }
        Timer::after_secs(PAUSE).await;
    }
}

/// Returns the network of the settings.
fn station(settings: &Settings<'_>) -> Option<StationConfig> {
    let authentication = match settings.passphrase {
        "" => AuthenticationMethodConfig::Open,
        passphrase => AuthenticationMethodConfig::Wpa2Personal(passphrase.try_into().ok()?),
    };
    Some(StationConfig::default().with_ssid(settings.ssid?.try_into().ok()?).with_authentication(authentication))
}
