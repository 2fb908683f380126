//! A report as CSV: one figure a line, so that tables of different columns share one file.

use super::{Report, table::Cell};

/// `table,row,figure,unit,by,value` for every figure that there is.
pub(super) fn csv(report: &Report) -> String {
    let mut text = String::from("table,row,figure,unit,by,value\r\n");
    for table in &report.tables {
        for row in &table.rows {
            for column in &table.columns {
                let value = match table.cell(row, column.key) {
                    Cell::Number(value) => value.to_string(),
                    Cell::Text(text) => text.clone(),
                    Cell::Empty => continue,
                };
                let by = format!("{:?}", column.by).to_lowercase();
                let fields = [table.id, &row.key, column.key, column.unit, &by, &value];
                text += &fields.map(quoted).join(",");
                text += "\r\n";
            }
        }
    }
    text
}

/// RFC 4180: fields with separators stand in quotes, quotes are doubled.
fn quoted(field: &str) -> String {
    if field.contains([',', '"', '\r', '\n']) {
        format!("\"{}\"", field.replace('"', "\"\""))
    } else {
        field.into()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Separators and quotes stay within their field.
    #[test]
    fn fields_are_quoted_where_they_must_be() {
        assert_eq!(quoted("plain"), "plain");
        assert_eq!(quoted("a,b"), "\"a,b\"");
        assert_eq!(quoted("a \"b\"\n"), "\"a \"\"b\"\"\n\"");
    }
}
