//! Pages of a history in a real browser: links lead from machine to report, nothing is asked of others, nothing is said to the
//! console.

use serde_json::json;

use crate::history::serve::{Served, forty_weeks};
use crate::outside::browser::{browser, for_root};
use crate::outside::driver::Driver;
use crate::support::temporary;

#[test]
fn a_browser_goes_from_machine_to_report() {
    let Some(browser) = browser("a_browser_goes_from_machine_to_report") else { return };
    let folder = temporary();
    forty_weeks(folder.path());
    let served = Served::start(folder.path(), "plant.sqlite");
    let mut driver = Driver::start(browser, for_root());
    let own = format!("http://{}/", served.address);
    for size in [[1200, 900], [360, 740]] {
        driver.go(&own, size, false);
        let title = "document.querySelector('h1').textContent";
        assert_eq!(driver.text(title), "Calibrations over time");
        let follow = |driver: &mut Driver, link: &str| {
            driver.forget();
            driver.value(&format!("document.querySelector({}).click()", json!(link)));
            driver.loaded();
        };
        follow(&mut driver, "a[href^=\"/machine?name=\"]");
        follow(&mut driver, "a[href*=\"&baseline=baseline\"]");
        assert_eq!(driver.text("document.querySelector('.verdict').textContent"), "Alarm");
        let charts = driver.value("document.querySelectorAll('svg[aria-label^=\"Control chart\"]').length");
        assert_eq!(charts, json!(13));
        assert!(driver.text("document.querySelector('#trend').textContent").contains("jump in week 23"));
        // No part is wider than the window, but for tables that scroll in themselves.
        let beyond = "document.documentElement.scrollWidth > innerWidth";
        assert_eq!(driver.value(beyond), json!(false), "{size:?}");
        follow(&mut driver, "#tests a[href^=\"/entry/1/weekly\"]");
        assert!(driver.text(title).contains("weekly.week-40"), "{}", driver.text(title));
        assert_eq!(driver.complaints_but(&own), [""; 0]);
    }
    // The way back.
    driver.go(&format!("{own}entry/1"), [1200, 900], true);
    driver.forget();
    driver.value("document.querySelector('header a[href=\"/\"]').click()");
    driver.loaded();
    assert_eq!(driver.text("document.querySelector('h1').textContent"), "Calibrations over time");
}
