//! A table, written as CSV or Markdown.

#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Table {
    pub head: Vec<String>,
    /// Rows, each as long as the head.
    pub rows: Vec<Vec<String>>,
}

impl Table {
    /// Returns an empty table; `head` is `column | column | …`.
    pub fn new(head: &str) -> Self {
        Self { head: head.split(" | ").map(str::to_owned).collect(), rows: Vec::new() }
    }

    /// Returns a row's cell; empty if there is no such column.
    pub fn text<'a>(&self, row: &'a [String], column: &str) -> &'a str {
        let place = self.head.iter().position(|name| name == column);
        place.and_then(|place| row.get(place)).map_or("", String::as_str)
    }

    /// Returns a row's number; NaN if there is none in that column.
    pub fn number(&self, row: &[String], column: &str) -> f64 {
        self.text(row, column).parse().unwrap_or(f64::NAN)
    }

    /// Returns RFC 4180 text.
    pub fn csv(&self) -> String {
        let cell = |cell: &String| {
            if cell.contains([',', '"', '\n', '\r']) {
                format!("\"{}\"", cell.replace('"', "\"\""))
            } else {
                cell.clone()
            }
        };
        self.lines(|row| row.iter().map(cell).collect::<Vec<_>>().join(","))
    }

    /// Returns a Markdown table with numbers aligned right.
    pub fn markdown(&self) -> String {
        let line = |cells: Vec<String>| format!("| {} |", cells.join(" | "));
        let rule = (0..self.head.len()).map(|column| {
            let is_number = |row: &Vec<String>| row[column].trim_end_matches(" %").parse::<f64>().is_ok();
            let numbers = self.rows.iter().filter(|row| is_number(row)).count();
            if numbers * 2 > self.rows.len() { "---:".to_owned() } else { "---".to_owned() }
        });
        let rule = line(rule.collect());
        let mut text = self.lines(|row| line(row.iter().map(|cell| cell.replace('|', "\\|")).collect()));
        let first = text.find('\n').map_or(text.len(), |end| end + 1);
        text.insert_str(first, &format!("{rule}\n"));
        text
    }

    fn lines(&self, line: impl Fn(&Vec<String>) -> String) -> String {
        std::iter::once(&self.head).chain(&self.rows).map(|row| line(row) + "\n").collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_are_quoted_and_aligned() {
        let mut table = Table::new("what | frames/s");
        table.rows.push(vec!["a, \"b\"|c".into(), "12.5".into()]);
        assert_eq!(table.csv(), "what,frames/s\n\"a, \"\"b\"\"|c\",12.5\n");
        assert_eq!(table.markdown(), "| what | frames/s |\n| --- | ---: |\n| a, \"b\"\\|c | 12.5 |\n");
    }
}
