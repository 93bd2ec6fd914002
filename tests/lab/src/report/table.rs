//! A table of text, as CSV for machines and as Markdown for documents.

/// Rows of cells under a head.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Table {
    /// Names of the columns.
    pub head: Vec<String>,
    /// Rows, each as long as the head.
    pub rows: Vec<Vec<String>>,
}

impl Table {
    /// A table without rows.
    #[must_use]
    pub fn new(head: &[&str]) -> Self {
        Self { head: head.iter().map(|&name| name.to_owned()).collect(), rows: Vec::new() }
    }

    /// RFC 4180 text: cells with commas, quotes or line ends are quoted.
    #[must_use]
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

    /// A Markdown table, numbers to the right.
    #[must_use]
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

/// The middle value, or the mean of the two middle ones; `None` of nothing.
#[must_use]
pub fn median(values: &[f64]) -> Option<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let upper = sorted.get(sorted.len() / 2)?;
    Some(if sorted.len() % 2 == 1 { *upper } else { f64::midpoint(sorted[sorted.len() / 2 - 1], *upper) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_are_quoted_and_aligned() {
        let mut table = Table::new(&["what", "frames/s"]);
        table.rows.push(vec!["a, \"b\"|c".into(), "12.5".into()]);
        assert_eq!(table.csv(), "what,frames/s\n\"a, \"\"b\"\"|c\",12.5\n");
        assert_eq!(table.markdown(), "| what | frames/s |\n| --- | ---: |\n| a, \"b\"\\|c | 12.5 |\n");
    }

    #[test]
    fn medians_are_the_middle() {
        assert_eq!(median(&[]), None);
        assert_eq!(median(&[3.0, 1.0, 2.0]), Some(2.0));
        assert_eq!(median(&[4.0, 1.0, 2.0, 3.0]), Some(2.5));
    }
}
