#[derive(Debug, Clone)]
pub struct Finding {
    pub goal: String,
    pub measured: String,
    pub met: bool,
}

impl Finding {
    pub fn new(goal: &str, measured: String, met: bool) -> Self {
        Self { goal: goal.to_owned(), measured, met }
    }
}
