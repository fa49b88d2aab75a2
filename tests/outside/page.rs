//! A page as people use it: points are picked, sliders move what they say, keys go where they should; in a narrow window, in the
//! dark, on paper.

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use serde_json::json;

use crate::outside::browser::{browser, for_root, page_of};
use crate::outside::driver::Driver;
use crate::support::{Small, as_typed, program, read, root, skipped, temporary};

const WIDE: [u32; 2] = [1200, 900];
const NARROW: [u32; 2] = [360, 740];

/// A browser; none, and the test is skipped, without one.
fn driver(test: &str) -> Option<Driver> {
    browser(test).map(|browser| Driver::start(browser, for_root()))
}

/// Whether the page shows its viewer; the test is skipped without WebGL 2.
fn has_viewer(driver: &mut Driver, test: &str) -> bool {
    let shown = driver.value("document.querySelector('.viewer')?.hidden === false") == json!(true);
    if !shown {
        skipped(test, "the browser has no WebGL 2");
    }
    shown
}

#[test]
fn picks_and_sliders_do_what_they_say() {
    let test = "picks_and_sliders_do_what_they_say";
    let Some(mut driver) = driver(test) else { return };
    let out = temporary();
    let page = page_of("first-steps", out.path());
    driver.open(&page, WIDE, false);
    if !has_viewer(&mut driver, test) {
        return;
    }
    let picked = "document.querySelector('[data-part=picked]').textContent";
    // The largest residual in its uncertainties, by the table.
    let table = read(&page.with_file_name("fit.residuals.csv"));
    let cells: Vec<Vec<&str>> = table.lines().skip(1).map(|line| line.split(',').collect()).collect();
    let number = |text: &str| text.parse::<f64>().expect("a number");
    let over = |row: &Vec<&str>| (number(row[4]) / number(row[5])).abs();
    let worst = cells.iter().max_by(|one, other| over(one).total_cmp(&over(other))).expect("a row");
    driver.value("document.querySelector('[data-part=worse]').click()");
    let said = driver.text(picked);
    assert!(said.starts_with(&format!("{}:{} (row {}), table: residual ", worst[1], worst[2], worst[3])), "{said}");
    // The machine went where this row was measured.
    let header: Vec<&str> = table.lines().next().expect("a header").split(',').collect();
    let column = header.iter().position(|name| *name == "X_mm").expect("a column");
    let stands = driver.text("document.querySelector('[data-axis=\"2\"]').parentElement.textContent");
    let stands: Vec<&str> = stands.split_whitespace().collect();
    assert_eq!(stands[0], "X", "{stands:?}");
    assert!((number(stands[1]) - number(worst[column])).abs() < 0.06, "{stands:?}, not {}", worst[column]);
    // Everything that moves changes the picture, and says what it is.
    let mut last = driver.picture();
    let mut changes = |driver: &mut Driver, what: &str| {
        let now = driver.picture();
        assert!(now != last, "{what} changes nothing");
        last = now;
    };
    for (slider, value, told) in [("arrows", "4", "10000"), ("errors", "3", "1000"), ("ellipsoids", "4", "10000")] {
        driver.set(&format!("[data-part={slider}]"), value);
        changes(&mut driver, slider);
        assert_eq!(driver.text(&format!("document.querySelector('[data-told={slider}]').textContent")), told);
    }
    driver.set("[data-part=slice]", "0");
    changes(&mut driver, "a slice");
    let slice = "document.querySelector('[data-told=at]').textContent";
    let middle = driver.text(slice);
    assert!(middle.starts_with("X ") && middle.contains(": error ") && middle.ends_with(" µm"), "{middle}");
    driver.set("[data-part=at]", "1");
    changes(&mut driver, "the place of the slice");
    assert_ne!(driver.text(slice), middle);
    let before = driver.text(slice);
    driver.set("[data-part=shown]", "1");
    changes(&mut driver, "before and after");
    assert_ne!(driver.text(slice), before);
    driver.set("[data-axis=\"2\"]", "100");
    changes(&mut driver, "an axis");
    let told = driver.text("document.querySelector('[data-told-axis=\"2\"]').textContent");
    // A slider has steps of a thousandth.
    assert!((number(&told) - 100.0).abs() < 0.6, "{told}");
    driver.value("document.querySelector('[data-part=machine]').click()");
    changes(&mut driver, "the machine");
    // A click on the middle of a point picks it: its place is that of the mark of a pick.
    let found = clicked(&mut driver, picked);
    assert!(found, "no click on the canvas picks a point");
    assert_eq!(driver.complaints(), [""; 0]);
}

/// Whether one of many clicks on the canvas picks another point.
fn clicked(driver: &mut Driver, picked: &str) -> bool {
    let before = driver.text(picked);
    driver.value("document.querySelector('.viewer canvas').scrollIntoView()");
    let place = driver.value(
        "(() => { const r = document.querySelector('.viewer canvas').getBoundingClientRect(); return [r.x, r.y, r.width, r.height]; })()",
    );
    let [x, y, width, height] = [0, 1, 2, 3].map(|index| place[index].as_f64().expect("a number"));
    for step in 0..64 {
        let (across, down) = (f64::from(step % 8) / 7.0 - 0.5, f64::from(step / 8) / 7.0 - 0.5);
        driver.click([x + width / 2.0 + 0.4 * height * across, y + height / 2.0 + 0.6 * height * down]);
        if driver.text(picked) != before {
            return true;
        }
    }
    false
}

#[test]
fn keys_go_through_the_page() {
    let test = "keys_go_through_the_page";
    let Some(mut driver) = driver(test) else { return };
    let out = temporary();
    let page = page_of("first-steps", out.path());
    driver.open(&page, WIDE, false);
    let focused = "document.activeElement.className + '|' + document.activeElement.tagName";
    driver.press("Tab", 9);
    assert_eq!(driver.text(focused), "skip|A");
    // It is seen as long as it has the focus.
    let left = driver.value("document.activeElement.getBoundingClientRect().left");
    assert!(left.as_f64().is_some_and(|left| left >= 0.0), "{left}");
    driver.press("Enter", 13);
    assert_eq!(driver.text("location.hash"), "#main");
    // Whatever can be clicked has the keyboard as well.
    let skipped_ones = driver.value(
        "[...document.querySelectorAll('a[href], button, input, select, summary, canvas')].filter((one) => one.tabIndex < 0).length",
    );
    assert_eq!(skipped_ones, json!(0));
    // A part opens with a key.
    driver.value("document.querySelector('details:not([open]) > summary').focus()");
    driver.press("Enter", 13);
    assert_eq!(driver.value("document.activeElement.parentElement.open"), json!(true));
    if !has_viewer(&mut driver, test) {
        return;
    }
    driver.value("document.querySelector('.viewer canvas').focus()");
    for (key, number) in [("ArrowLeft", 37), ("ArrowUp", 38), ("+", 187)] {
        let before = driver.picture();
        driver.press(key, number);
        assert!(driver.picture() != before, "{key} changes nothing");
    }
    assert_eq!(driver.complaints(), [""; 0]);
}

/// No part is wider than a telephone, but for tables and drawings that scroll by themselves.
#[test]
fn a_narrow_window_shows_all() {
    let test = "a_narrow_window_shows_all";
    let Some(mut driver) = driver(test) else { return };
    let out = temporary();
    for name in ["tango-hu40t", "tool-check"] {
        let page = page_of(name, out.path());
        for size in [NARROW, WIDE] {
            driver.open(&page, size, false);
            driver.value("document.querySelectorAll('details').forEach((one) => (one.open = true))");
            driver.rest();
            let width = driver.value("document.documentElement.scrollWidth").as_u64().expect("a width");
            assert!(width <= u64::from(size[0]), "{name}: {width} in a window of {}", size[0]);
        }
        assert_eq!(driver.complaints(), [""; 0], "{name}");
    }
}

/// Contrast of texts on their grounds, WCAG 2: at least 4.5 to 1.
const CONTRAST: &str = "(() => {
  const style = getComputedStyle(document.documentElement);
  const light = (name) => {
    const text = style.getPropertyValue(name).trim();
    const whole = text.length === 4 ? '#' + [...text.slice(1)].map((one) => one + one).join('') : text;
    const parts = [1, 3, 5].map((k) => parseInt(whole.slice(k, k + 2), 16) / 255);
    const linear = parts.map((one) => (one <= 0.04045 ? one / 12.92 : ((one + 0.055) / 1.055) ** 2.4));
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2];
  };
  const all = [];
  for (const ground of ['--page', '--card'])
    for (const text of ['--text', '--soft', '--pass', '--fail', '--unsure', '--s0']) {
      const [one, other] = [light(ground), light(text)].sort();
      all.push([text + ' on ' + ground, (other + 0.05) / (one + 0.05)]);
    }
  return all;
})()";

#[test]
fn texts_can_be_read_in_the_light_and_in_the_dark() {
    let Some(mut driver) = driver("texts_can_be_read_in_the_light_and_in_the_dark") else { return };
    let out = temporary();
    let page = page_of("first-steps", out.path());
    let mut grounds = Vec::new();
    for is_dark in [false, true] {
        driver.open(&page, WIDE, is_dark);
        for pair in driver.value(CONTRAST).as_array().expect("a list") {
            assert!(pair[1].as_f64().is_some_and(|contrast| contrast >= 4.5), "dark: {is_dark}: {pair}");
        }
        grounds.push(driver.text("getComputedStyle(document.body).backgroundColor"));
        assert_eq!(driver.complaints(), [""; 0]);
    }
    assert_eq!(grounds, ["rgb(255, 255, 255)", "rgb(21, 24, 28)"]);
}

/// Several runs have a viewer each, and the first one shows the fields of all.
#[test]
fn several_runs_have_their_viewers() {
    let test = "several_runs_have_their_viewers";
    let Some(mut driver) = driver(test) else { return };
    let out = temporary();
    let folders = ["one", "two"].map(|name| page_of("first-steps", &out.path().join(name)));
    let page = out.path().join("both.html");
    let folder = |page: &Path| page.parent().expect("a folder").to_owned();
    let [one, two] = [&folders[0], &folders[1]].map(|page| folder(page));
    let arguments = ["report".as_ref(), one.as_os_str(), two.as_os_str(), "--out".as_ref(), page.as_os_str()];
    let printed = as_typed(&root(), &arguments);
    assert_eq!(printed.status, 0, "{}", printed.stderr);
    driver.open(&page, WIDE, false);
    if !has_viewer(&mut driver, test) {
        return;
    }
    assert_eq!(driver.value("document.querySelectorAll('.viewer:not([hidden])').length"), json!(2));
    let named =
        driver.text("[...document.querySelector('[data-part=shown]').options].map((one) => one.text).join('; ')");
    assert!(named.contains(&format!("in {}", two.display())), "{named}");
    // A row of the second run is a link to the second viewer.
    let id = driver.text("document.querySelectorAll('.viewer')[1].id");
    assert_eq!(id, "viewer-2");
    driver.value("document.querySelector('a[href^=\"#point-2-\"]').click()");
    driver.rest();
    let said = driver.value(
        "[...document.querySelectorAll('[data-part=picked]')].map((one) => one.textContent.includes('residual '))",
    );
    assert_eq!(said[1], json!(true), "{said}");
    assert_eq!(driver.complaints(), [""; 0]);
}

/// `abbe report` prints the page by the same browser; A4, some sheets.
#[test]
fn abbe_prints_a_pdf() {
    let Some(name) = browser("abbe_prints_a_pdf") else { return };
    let small = Small::new();
    assert_eq!(small.abbe(&["run", "recipe.yaml"]).status, 0);
    let printed = small.abbe(&["report", "out/recipe", "--out", "page.pdf"]);
    assert_eq!((printed.status, printed.stdout.as_str()), (0, "Written: page.pdf\n"), "{name}: {}", printed.stderr);
    let bytes = std::fs::read(small.folder.path().join("page.pdf")).expect("a PDF");
    let text = String::from_utf8_lossy(&bytes);
    assert!(text.starts_with("%PDF-"));
    assert!(text.contains("/MediaBox [0 0 594.9") || text.contains("/MediaBox [0 0 595"), "no A4");
    let sheets = text.matches("/Type /Page\n").count() + text.matches("/Type/Page\n").count();
    assert!((2..40).contains(&sheets), "{sheets} sheets");
}

/// Whatever the browser is about to write when a signal comes: nothing of it stays.
#[cfg(unix)]
#[test]
fn a_signal_while_a_pdf_is_printed_leaves_nothing() {
    if browser("a_signal_while_a_pdf_is_printed_leaves_nothing").is_none() {
        return;
    }
    let small = Small::new();
    assert_eq!(small.abbe(&["run", "recipe.yaml"]).status, 0);
    let at = small.folder.path();
    let temporary = at.join("temporary");
    std::fs::create_dir(&temporary).expect("a folder");
    for milliseconds in [200, 600, 1000, 1400, 1800, 2200, 2600, 3000] {
        let mut command = program(at, &["report", "out/recipe", "--out", "page.pdf"]);
        command.env("TMPDIR", &temporary).stdout(Stdio::null()).stderr(Stdio::null());
        let mut printing = command.spawn().expect("it starts");
        std::thread::sleep(Duration::from_millis(milliseconds));
        // It may have ended by now.
        let _ = Command::new("kill").args(["-TERM", &printing.id().to_string()]).stderr(Stdio::null()).status();
        printing.wait().expect("it ends");
        let left: Vec<_> = std::fs::read_dir(&temporary).expect("a folder").flatten().map(|own| own.path()).collect();
        assert!(left.is_empty(), "after {milliseconds} ms: {left:?}");
        let _ = std::fs::remove_file(at.join("page.pdf"));
    }
}
