//! Chromium, controlled through chromedriver.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::process::{Child, Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use super::webdriver::{WebDriverClient, WebElement};

/// Timeout of every wait; a computer that also compiles is slow.
const PAGE_TIMEOUT: Duration = Duration::from_secs(300);

pub struct ChromeDriver {
    child: Child,
    port: u16,
}

impl Drop for ChromeDriver {
    /// The browser ends with its driver, but not if the driver is killed.
    fn drop(&mut self) {
        if let Ok(mut stream) = TcpStream::connect(("127.0.0.1", self.port)) {
            let _ = stream.set_read_timeout(Some(Duration::from_secs(10)));
            let _ = stream.write_all(b"GET /shutdown HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n");
            let _ = stream.read_to_end(&mut Vec::new());
        }
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Number of start attempts: the driver takes a free IPv4 port, and exits if another process uses the same IPv6
/// port.
const MAX_START_ATTEMPTS: usize = 5;

impl ChromeDriver {
    pub fn start() -> Self {
        (0..MAX_START_ATTEMPTS).find_map(|_| Self::try_start()).expect("a port of chromedriver")
    }

    fn try_start() -> Option<Self> {
        let mut command = Command::new("chromedriver");
        command.arg("--port=0").stdout(Stdio::piped()).stderr(Stdio::null());
        let mut child = command.spawn().expect("chromedriver");
        let told = BufReader::new(child.stdout.take().expect("piped"));
        let at = |line: String| {
            let (_, port) = line.split_once("started successfully on port ")?;
            port.trim_end_matches('.').parse().ok()
        };
        match told.lines().map_while(Result::ok).find_map(at) {
            Some(port) => Some(Self { child, port }),
            None => {
                let _ = child.wait();
                None
            }
        }
    }
}

pub struct Browser {
    pub client: WebDriverClient,
    /// Must outlive the client.
    _driver: ChromeDriver,
}

impl Browser {
    pub fn open() -> Self {
        let driver = ChromeDriver::start();
        let capabilities = json!({
            // As root, for example in a container, Chromium cannot use its sandbox.
            "goog:chromeOptions": {"args": ["--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars"]},
            "goog:loggingPrefs": {"browser": "ALL"},
        });
        let client = WebDriverClient::open_session(driver.port, &capabilities, PAGE_TIMEOUT).expect("a session");
        Self { client, _driver: driver }
    }

    /// A command of the Chrome DevTools Protocol.
    pub fn run_devtools_command(&self, command: &str, params: &Value) {
        self.client.run_devtools_command(command, params).expect(command);
    }

    /// Console entries since the last call.
    pub fn take_console_entries(&self) -> Vec<String> {
        let entries = self.client.take_console_entries().expect("the log");
        entries.iter().map(|entry| format!("{}: {}", entry["level"], entry["message"])).collect()
    }

    pub fn set_window_size(&self, [width, height]: [u32; 2]) {
        let metrics = json!({"width": width, "height": height, "deviceScaleFactor": 1, "mobile": false});
        self.run_devtools_command("Emulation.setDeviceMetricsOverride", &metrics);
    }

    pub fn wait_for_element(&self, css: &str) -> WebElement<'_> {
        let started = Instant::now();
        loop {
            match self.client.find_element(css) {
                Ok(element) => return element,
                Err(error) if error.code != "no such element" || started.elapsed() > PAGE_TIMEOUT => {
                    panic!("{css}: {error}\n{}", self.visible_text("body"))
                }
                Err(_) => sleep(Duration::from_millis(250)),
            }
        }
    }

    /// Visible text of the first element that matches now.
    pub fn visible_text(&self, css: &str) -> String {
        let script = "const found = document.querySelector(arguments[0]); return found ? found.innerText : ''";
        let text = self.client.execute_script(script, &[json!(css)]);
        text.ok().and_then(|text| text.as_str().map(str::to_owned)).unwrap_or_default()
    }

    /// Waits until the text of the element satisfies `right`.
    pub fn wait_for_text(&self, css: &str, right: impl Fn(&str) -> bool) -> String {
        let started = Instant::now();
        loop {
            let text = self.visible_text(css);
            if right(&text) {
                return text;
            }
            assert!(started.elapsed() < PAGE_TIMEOUT, "{css}: {text}");
            sleep(Duration::from_millis(50));
        }
    }

    /// Fills in and submits the form to `action`: fields by name, and all check boxes ticked.
    pub fn fill_and_submit_form(&self, action: &str, fields: &[(&str, &str)]) {
        let form = format!("form[action$='{action}']");
        let tick = "for (const box of document.querySelectorAll(arguments[0])) box.click()";
        self.wait_for_element(&form);
        let boxes = format!("{form} input[type=checkbox]");
        self.client.execute_script(tick, &[json!(boxes)]).expect("boxes");
        for (name, value) in fields {
            self.wait_for_element(&format!("{form} [name={name}]")).send_keys(value).expect(name);
        }
        self.wait_for_element(&format!("{form} button")).click().expect("a button");
    }
}
