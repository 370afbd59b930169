//! Percent-encoding of texts in addresses (RFC 3986, 2.1).

/// `text` with every byte encoded that is not unreserved (RFC 3986, 2.3).
pub fn percent_encode(text: &str) -> String {
    let is_unreserved = |byte: u8| byte.is_ascii_alphanumeric() || b"-_.~".contains(&byte);
    let encode = |byte: u8| if is_unreserved(byte) { char::from(byte).to_string() } else { format!("%{byte:02X}") };
    text.bytes().map(encode).collect()
}
