# Texts of the forms that come before anything else. The cell writes these pages: each text on one line.

## Log in
login-title = { $cell }：登录
login-name = 姓名
login-name-or-page = 姓名（留空则使用状态页面的密码）
login-password = 密码
login-password-of-page = { $cell } 状态页面的密码
login-button = 登录
login-code = 我有代码
login-wrong = 姓名或密码错误。
login-wrong-password = 密码错误。
login-wait = { $wait_s } 秒内不接受密码：错误次数过多，或正在验证另一个密码。请稍后再试。

## Come in by a code
invite-title = { $cell }：代码
invite-what = 代码在单元的日志中，或由 { $command } 生成。它只能使用一次，并使您成为工程师。
invite-code = 代码
invite-name = 您的姓名
invite-password = 密码，至少 { $least } 个字符
invite-again = 再次输入密码
invite-wrong = 此代码错误、已使用、属于其他姓名，或已超过一天。{ $command } 可生成新代码。
invite-differ = 两次输入的密码不一致。
invite-short = 请输入姓名和至少 { $least } 个字符的密码。
invite-common = 此密码太容易被猜到。请使用由多个单词组成、不含姓名的密码。
invite-storage = 无法将您设为工程师：{ $detail }
