//! Query of the list of runs: range and filters.

use serde::de::IntoDeserializer;
use serde::{Deserialize, Deserializer};
use utoipa::IntoParams;

use super::openapi::schemas::VerdictSchema;
use super::percent_encode::percent_encode;
use crate::store::{RunFilter, RunId};
use machine::record::estimate::Verdict;

/// Maximum and default number of items in a list.
const MAX_LIST_ITEMS: usize = 200;

/// Number of items to return, at most [`MAX_LIST_ITEMS`].
pub fn item_limit(limit: Option<usize>) -> usize {
    limit.unwrap_or(MAX_LIST_ITEMS).min(MAX_LIST_ITEMS)
}

/// Range and filters of runs. An empty text is no filter: a form sends it for "all".
#[derive(Debug, Clone, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
pub struct RunListQuery {
    /// Only runs older than this one.
    before: Option<i64>,
    /// Only runs newer than this one; without `before`, those that follow it directly.
    after: Option<i64>,
    limit: Option<usize>,
    #[serde(default, deserialize_with = "empty_text_as_none")]
    pub machine: Option<String>,
    #[serde(default, deserialize_with = "empty_text_as_none")]
    pub method: Option<String>,
    /// Verdict of the last estimate.
    #[serde(default, deserialize_with = "empty_verdict_as_none")]
    #[param(value_type = Option<VerdictSchema>)]
    pub verdict: Option<Verdict>,
}

impl RunListQuery {
    pub fn filter(&self) -> RunFilter<'_> {
        let [before, after] = [self.before, self.after].map(|run| run.map(RunId));
        RunFilter {
            older_than: before,
            newer_than: after,
            machine: self.machine.as_deref(),
            method: self.method.as_deref(),
            verdict: self.verdict,
            ..RunFilter::default()
        }
    }

    pub fn item_limit(&self) -> usize {
        item_limit(self.limit)
    }

    /// The filters as further parameters of a link, each with `&` before it; without the range and the limit.
    pub fn filter_query(&self) -> String {
        let verdict = self.verdict.map(|verdict| verdict.to_string());
        let chosen =
            [("machine", self.machine.as_ref()), ("method", self.method.as_ref()), ("verdict", verdict.as_ref())];
        let chosen = chosen.into_iter().filter_map(|(key, value)| Some((key, value?)));
        chosen.map(|(key, value)| format!("&{key}={}", percent_encode(value))).collect()
    }
}

fn empty_text_as_none<'de, D: Deserializer<'de>>(text: D) -> Result<Option<String>, D::Error> {
    Ok(Option::<String>::deserialize(text)?.filter(|text| !text.is_empty()))
}

fn empty_verdict_as_none<'de, D: Deserializer<'de>>(text: D) -> Result<Option<Verdict>, D::Error> {
    let text = empty_text_as_none(text)?;
    text.map(|text| Verdict::deserialize(text.into_deserializer())).transpose()
}
