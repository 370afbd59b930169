//! Chromium behind its driver.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use axum::http::Method;
use fantoccini::elements::Element;
use fantoccini::wd::{TimeoutConfiguration, WebDriverCompatibleCommand};
use fantoccini::{Client, ClientBuilder, Locator};
use hyper_util::client::legacy::connect::HttpConnector;
use serde_json::{Value, json};

/// For whatever is waited for; a computer that compiles as well is slow.
const PATIENCE: Duration = Duration::from_secs(300);

pub struct Driver {
    child: Child,
    port: u16,
}

impl Drop for Driver {
    /// The browser ends with its driver, but not if that is killed.
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

impl Driver {
    pub fn start() -> Self {
        let mut command = Command::new("chromedriver");
        command.arg("--port=0").stdout(Stdio::piped()).stderr(Stdio::null());
        let mut child = command.spawn().expect("chromedriver");
        let told = BufReader::new(child.stdout.take().expect("piped"));
        let at = |line: String| {
            let (_, port) = line.split_once("started successfully on port ")?;
            port.trim_end_matches('.').parse().ok()
        };
        let port = told.lines().map_while(Result::ok).find_map(at);
        Self { child, port: port.expect("a port of chromedriver") }
    }
}

/// Runs a trial with a browser of its own.
pub fn in_browser(trial: impl AsyncFnOnce(Browser)) {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async { trial(Browser::open(Driver::start()).await).await });
}

pub struct Browser {
    pub client: Client,
    /// Outlives the client.
    _driver: Driver,
}

/// What WebDriver alone does not know: `what` below the session.
#[derive(Debug)]
struct Vendor {
    what: &'static str,
    body: Value,
}

impl WebDriverCompatibleCommand for Vendor {
    fn endpoint(
        &self,
        base: &url::Url,
        session: Option<&str>,
    ) -> Result<url::Url, url::ParseError> {
        base.join(&format!("session/{}/{}", session.unwrap_or_default(), self.what))
    }

    fn method_and_body(&self, _: &url::Url) -> (Method, Option<String>) {
        (Method::POST, Some(self.body.to_string()))
    }
}

impl Browser {
    pub async fn open(driver: Driver) -> Self {
        let wanted = json!({
            // As root, as in a container, Chromium has no sandbox of its own.
            "goog:chromeOptions": {"args": ["--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars"]},
            "goog:loggingPrefs": {"browser": "ALL"},
        });
        let Value::Object(wanted) = wanted else { unreachable!() };
        let mut builder = ClientBuilder::new(HttpConnector::new());
        let at = format!("http://127.0.0.1:{}", driver.port);
        let client = builder.capabilities(wanted).connect(&at).await.expect("a session");
        let patience = TimeoutConfiguration::new(Some(PATIENCE), Some(PATIENCE), None);
        client.update_timeouts(patience).await.expect("patience");
        Self { client, _driver: driver }
    }

    /// Of Chrome's own protocol.
    pub async fn tell(&self, command: &str, params: Value) {
        let body = json!({"cmd": command, "params": params});
        self.client.issue_cmd(Vendor { what: "goog/cdp/execute", body }).await.expect(command);
    }

    /// What stood in the console since it was asked for last.
    pub async fn console(&self) -> Vec<String> {
        let body = json!({"type": "browser"});
        let said = self.client.issue_cmd(Vendor { what: "se/log", body }).await.expect("the log");
        let lines = said.as_array().expect("a list").iter();
        lines.map(|line| format!("{}: {}", line["level"], line["message"])).collect()
    }

    pub async fn size(&self, [width, height]: [u32; 2]) {
        let metrics =
            json!({"width": width, "height": height, "deviceScaleFactor": 1, "mobile": false});
        self.tell("Emulation.setDeviceMetricsOverride", metrics).await;
    }

    pub async fn find(&self, css: &str) -> Element {
        let found = self.client.wait().at_most(PATIENCE).for_element(Locator::Css(css)).await;
        match found {
            Ok(element) => element,
            Err(error) => panic!("{css}: {error}\n{}", self.text("body").await),
        }
    }

    /// Of what is there now.
    pub async fn text(&self, css: &str) -> String {
        let script = "const found = document.querySelector(arguments[0]); return found ? found.innerText : ''";
        let text = self.client.execute(script, vec![json!(css)]).await;
        text.ok().and_then(|text| text.as_str().map(str::to_owned)).unwrap_or_default()
    }

    /// Wait for it.
    pub async fn until(&self, css: &str, right: impl Fn(&str) -> bool) -> String {
        let started = Instant::now();
        loop {
            let text = self.text(css).await;
            if right(&text) {
                return text;
            }
            assert!(started.elapsed() < PATIENCE, "{css}: {text}");
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    }

    /// Fill in and send the form to `action`: fields by name, and each box that is to be ticked.
    pub async fn send(&self, action: &str, fields: &[(&str, &str)]) {
        let form = format!("form[action$='{action}']");
        let tick = "for (const box of document.querySelectorAll(arguments[0])) box.click()";
        self.find(&form).await;
        let boxes = format!("{form} input[type=checkbox]");
        self.client.execute(tick, vec![json!(boxes)]).await.expect("boxes");
        for (name, value) in fields {
            self.find(&format!("{form} [name={name}]")).await.send_keys(value).await.expect(name);
        }
        self.find(&format!("{form} button")).await.click().await.expect("a button");
    }
}
