//! A blocking client of [W3C WebDriver](https://www.w3.org/TR/webdriver2/), with two commands specific to
//! chromedriver.

use std::time::Duration;

use serde_json::{Value, json};

/// Key of an element's id in JSON, fixed by the standard.
const ELEMENT_KEY: &str = "element-6066-11e4-a52e-4f735466cecf";

/// An error response of the driver.
#[derive(Debug, thiserror::Error)]
#[error("{message}")]
pub struct WebDriverError {
    /// For example `no such element`; chromedriver repeats it in `message`.
    pub code: String,
    message: String,
}

type WebDriverResult<T> = Result<T, WebDriverError>;

pub struct WebDriverClient {
    agent: ureq::Agent,
    session_url: String,
}

pub struct WebElement<'client> {
    client: &'client WebDriverClient,
    element_path: String,
}

impl WebDriverClient {
    /// `limit` applies to scripts and to page loads.
    pub fn open_session(port: u16, capabilities: &Value, limit: Duration) -> WebDriverResult<Self> {
        let config = ureq::Agent::config_builder().http_status_as_error(false).proxy(None).build();
        let mut client = Self { agent: config.into(), session_url: format!("http://127.0.0.1:{port}/session") };
        let opened = client.post("", &json!({"capabilities": {"alwaysMatch": capabilities}}))?;
        client.session_url = format!("{}/{}", client.session_url, string_value(&opened["sessionId"]));
        let limit_ms = limit.as_millis();
        client.post("/timeouts", &json!({"script": limit_ms, "pageLoad": limit_ms}))?;
        Ok(client)
    }

    fn get(&self, path: &str) -> WebDriverResult<Value> {
        response_value(self.agent.get(format!("{}{path}", self.session_url)).call())
    }

    fn post(&self, path: &str, body: &Value) -> WebDriverResult<Value> {
        response_value(self.agent.post(format!("{}{path}", self.session_url)).send_json(body))
    }

    pub fn open_url(&self, url: &str) -> WebDriverResult<()> {
        self.post("/url", &json!({"url": url})).map(drop)
    }

    pub fn reload_page(&self) -> WebDriverResult<()> {
        self.post("/refresh", &json!({})).map(drop)
    }

    pub fn page_title(&self) -> WebDriverResult<String> {
        self.get("/title").map(|title| string_value(&title))
    }

    /// Return value of `script`; of a promise, its value when it is fulfilled.
    pub fn execute_script(&self, script: &str, arguments: &[Value]) -> WebDriverResult<Value> {
        self.post("/execute/sync", &json!({"script": script, "args": arguments}))
    }

    pub fn find_element(&self, css: &str) -> WebDriverResult<WebElement<'_>> {
        self.post("/element", &css_selector_body(css)).map(|found| self.element_from_reply(&found))
    }

    pub fn find_elements(&self, css: &str) -> WebDriverResult<Vec<WebElement<'_>>> {
        let found = self.post("/elements", &css_selector_body(css))?;
        Ok(array_value(&found).iter().map(|found| self.element_from_reply(found)).collect())
    }

    fn element_from_reply(&self, found: &Value) -> WebElement<'_> {
        WebElement { client: self, element_path: format!("/element/{}", string_value(&found[ELEMENT_KEY])) }
    }

    /// The visible part of the page as PNG.
    pub fn screenshot_png(&self) -> WebDriverResult<Vec<u8>> {
        self.get("/screenshot").map(|png| decode_base64(&string_value(&png)))
    }

    /// A command of the Chrome DevTools Protocol.
    pub fn run_devtools_command(&self, command: &str, params: &Value) -> WebDriverResult<()> {
        self.post("/goog/cdp/execute", &json!({"cmd": command, "params": params})).map(drop)
    }

    /// Console entries since the last call.
    pub fn take_console_entries(&self) -> WebDriverResult<Vec<Value>> {
        self.post("/se/log", &json!({"type": "browser"})).map(|entries| array_value(&entries).clone())
    }
}

impl WebElement<'_> {
    pub fn click(&self) -> WebDriverResult<()> {
        self.client.post(&format!("{}/click", self.element_path), &json!({})).map(drop)
    }

    pub fn send_keys(&self, text: &str) -> WebDriverResult<()> {
        self.client.post(&format!("{}/value", self.element_path), &json!({"text": text})).map(drop)
    }

    pub fn visible_text(&self) -> WebDriverResult<String> {
        self.client.get(&format!("{}/text", self.element_path)).map(|text| string_value(&text))
    }
}

/// Panics where the driver cannot be reached or its response is not WebDriver's.
fn response_value(response: Result<ureq::http::Response<ureq::Body>, ureq::Error>) -> WebDriverResult<Value> {
    let mut response = response.expect("a response of chromedriver");
    let mut body: Value = response.body_mut().read_json().expect("JSON from chromedriver");
    let value = body["value"].take();
    match response.status().is_success() {
        true => Ok(value),
        false => Err(WebDriverError { code: string_value(&value["error"]), message: string_value(&value["message"]) }),
    }
}

fn string_value(value: &Value) -> String {
    value.as_str().unwrap_or_else(|| panic!("not a string: {value}")).to_owned()
}

fn array_value(value: &Value) -> &Vec<Value> {
    value.as_array().unwrap_or_else(|| panic!("not a list: {value}"))
}

fn css_selector_body(css: &str) -> Value {
    json!({"using": "css selector", "value": css})
}

fn decode_base64(text: &str) -> Vec<u8> {
    const BASE64_ALPHABET: &str = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let sextet = |digit| BASE64_ALPHABET.find(digit).expect("a base64 digit") as u32;
    let sextets: Vec<u32> = text.trim_end_matches('=').chars().map(sextet).collect();
    let decode = |group: &[u32]| {
        let bits = group.iter().fold(0, |bits, sextet| (bits << 6) | sextet);
        (bits << (6 * (4 - group.len()))).to_be_bytes()[1..group.len()].to_vec()
    };
    sextets.chunks(4).flat_map(decode).collect()
}
